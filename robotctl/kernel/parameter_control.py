"""The part of the kernel that decides on changes of parameters."""

from __future__ import annotations

from robotctl.kernel.modes import Mode
from robotctl.kernel.parameter_change import ParameterChanged, ParameterRequested
from robotctl.kernel.parameters import conflict, kernel_leaves, text_of, value_at, with_text
from robotctl.kernel.params import KernelParams
from robotctl.kernel.ranges import Change
from robotctl.kernel.remedies import Remedy
from robotctl.kernel.request_control import RequestControl


class ParameterControl(RequestControl):
    """The decisions on changes; a parameter of the daemon alone is refused while MOVING only."""

    def _request_parameter(self, event: ParameterRequested) -> None:
        leaf = kernel_leaves().get(event.key)
        change = Change.STANDING if leaf is None else leaf.declared.metadata["change"]
        if change is Change.START:
            self._refuse(event.request_id, f"{event.key} changes at a start only")
            return
        if change is Change.STANDING and self.state.mode is Mode.MOVING:
            text = f"{event.key} does not change while the robot is MOVING"
            self._refuse(event.request_id, text, (Remedy.STOP_FIRST,))
            return
        if leaf is not None:
            now = text_of(value_at(self.params, leaf.path))
            if now != event.old:
                self._refuse(event.request_id, f"{event.key} is {now}, not {event.old}")
                return
            changed = self._changed(event)
            if changed is None:
                return
            self.params = changed
        if event.new != event.old:
            self._effects.append(ParameterChanged(event.key, event.old, event.new, event.source))
        self._accept(event.request_id, f"{event.key} is {event.new}")

    def _changed(self, event: ParameterRequested) -> KernelParams | None:
        """Return the new parameters; refuse the request and return None if they are not allowed."""
        try:
            changed = with_text(self.params, event.key, event.new)
        except ValueError as error:
            self._refuse(event.request_id, str(error))
            return None
        clash = conflict(changed)
        if clash is not None:
            refusal = f"{clash.key}: {clash.value} is not allowed: {clash.allowed}"
            self._refuse(event.request_id, refusal)
            return None
        return changed
