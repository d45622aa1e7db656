"""Puts this folder on the path, so that every test finds `shapes`, and keeps numpy to one thread.

Answers are the same to the bit only where sums are taken in one order.
"""

import os
import signal

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# A shell starts background commands with SIGINT ignored, which their child processes would inherit: commands
# that tests interrupt would not notice.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
