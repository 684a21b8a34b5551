"""ModeService, a node for your own program; `python -m` of this module owns the mode."""

from robotctl.daemon.mode_service import main

if __name__ == "__main__":
    raise SystemExit(main())

from robotctl.ros.executables.mode_service import ModeService

__all__ = ["ModeService", "main"]
