"""Old import paths of modules of `robotctl.collection`, for users of the library before 0.2."""

import sys

from robotctl.collection import gate, judging

sys.modules |= {
    f"{__name__}.baseline": gate,
    f"{__name__}.gate": gate,
    f"{__name__}.judging": judging,
    f"{__name__}.result_store": judging,
}
