"""Interfaces to large third-party packages, one module for each: functions of arrays that return arrays.

No other module of pcretrieve imports open3d, pytetwild or robust_laplacian. The import of open3d or pytetwild
takes more than a second, and is therefore made at the first use.
"""
