"""The gate under the names it had before 0.2: `robotctl.collection` has it now."""

import sys

from robotctl.collection import gate, judging

sys.modules |= {
    f"{__name__}.baseline": gate,
    f"{__name__}.gate": gate,
    f"{__name__}.judging": judging,
    f"{__name__}.result_store": judging,
}
