"""The heavy third parties, one file each: arrays in, arrays out.

Nothing else in pcretrieve imports open3d or pytetwild. Both take more than a second to import, so they are
imported when first used, never when pcretrieve is.
"""
