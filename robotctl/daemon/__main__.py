"""`python -m robotctl.daemon`, which a Ctrl-C during its imports ends without a traceback."""

import gc
import sys

from robotctl.base.errors import INTERRUPTED_EXIT_CODE

gc.disable()  # until the daemon is ready: imports make no garbage, but collections slow them 10 %
try:
    from robotctl.daemon.startup import main

    sys.exit(main(sys.argv[1:]))
except KeyboardInterrupt:
    sys.exit(INTERRUPTED_EXIT_CODE)
