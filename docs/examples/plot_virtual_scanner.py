"""
The virtual scanner
===================

Samples and benchmarks are scanned by simulated depth cameras. Each view sees one side; together, armpits
and soles are still missing.
"""

import numpy as np
from benchmarks.simulation import RigOptions, scan_views
from sample import draw, person

mesh = person(1, "stand")
options = RigOptions(n_views=4)
views = scan_views(mesh, options, np.random.default_rng(0))
draw({f"{len(view.points)} points": view for view in views} | {"body": mesh})
