"""The heavy third parties, one file each: arrays in, arrays out.

Nothing else in pcretrieve imports open3d, pytetwild or robust_laplacian. The first two take more than a
second to import, so all are imported when first used, never when pcretrieve is.
"""
