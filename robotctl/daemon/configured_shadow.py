"""Makes the shadow that the configuration names."""

from __future__ import annotations

from robotctl.daemon.control.shadow_run import ShadowRun
from robotctl.daemon.host import Host
from robotctl.daemon.recording.flight_recorder import FlightRecorder
from robotctl.kernel.shadow import Shadow
from robotctl.kernel.state import State


def shadow_run(host: Host, state: State, recorder: FlightRecorder) -> ShadowRun | None:
    """Return the shadow of a kernel in this state, None if none is configured.

    Its record goes to the recorder, and its failure to the warnings of `status`.
    """
    settings = host.shadow
    if settings is None:
        return None
    shadow = Shadow(settings.params, state, settings.own.keys())
    run = ShadowRun(shadow, str(settings.file), settings.digest, recorder.open_shadow())
    host.warnings.append(run.warning)
    return run
