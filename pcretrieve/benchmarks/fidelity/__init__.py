"""How true normals, surface, signature and ranking come back from a virtual scanner.

In come clean meshes, which are the truth, and pipeline options; the meshes are scanned, the scans go through
the pipeline, and out comes one row of figures for each set, scanner and choice of options.
"""
