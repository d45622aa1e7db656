"""Puts this folder on the path, so that every test finds `shapes`, and keeps numpy to one thread.

Answers are the same to the bit only where sums are taken in one order.
"""

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
