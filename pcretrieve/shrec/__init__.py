"""The systems that the paper is compared with: descriptors of one shape, and matchers of two.

Descriptors are registered as those of another package are, by the address of a record `Descriptor`, which is
imported when it is named (`pcretrieve.plugins.COMPARED`). Matchers compare pairs of shapes and have no vector
for a single one; `pcretrieve.shrec.matcher` holds their records.
"""
