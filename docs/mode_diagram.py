"""Prints the mode diagram of docs/architecture.md, drawn from the kernel's own table.

python docs/mode_diagram.py
"""

from __future__ import annotations

from robotctl.kernel.modes import TRANSITIONS, Guard, Mode


def mermaid() -> str:
    """Return a mermaid state diagram: every transition to another mode, and the ramp."""
    labels: dict[tuple[Mode, Mode], list[str]] = {}
    for (mode, trigger), transition in TRANSITIONS.items():
        ramps = transition.guard is Guard.RAMP_DOWN
        if transition.guard is Guard.NEVER or (transition.target is mode and not ramps):
            continue
        # The request begins the ramp; the standstill at its end is a trigger of its own.
        target = mode if ramps else transition.target
        guard = "" if transition.guard is Guard.NONE else f" [{transition.guard.value}]"
        labels.setdefault((mode, target), []).append(f"{trigger.value}{guard}")
    lines = ["stateDiagram-v2", "    [*] --> IDLE", "    [*] --> EMERGENCY_STOP: latched before"]
    for (mode, target), triggers in labels.items():
        lines.append(f"    {mode.name} --> {target.name}: {'<br/>'.join(triggers)}")
    return "\n".join(lines)


if __name__ == "__main__":
    print(mermaid())
