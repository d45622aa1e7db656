"""Fidelity: errors of normals, surface, signature and ranking after a virtual scan.

In come clean meshes, which are the ground truth, and pipeline options; the meshes are scanned virtually, the
scans are processed, and out comes one row of figures for each set, condition of scanning and configuration.
"""
