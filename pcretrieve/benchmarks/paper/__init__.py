"""The checks that the paper makes of its own descriptor, repeated.

In come the meshes of TOSCA and two flat drums; out come the figures of the paper beside ours. The paper:
J. Ye and Y. Yu, "A fast modal space transform for robust nonrigid shape retrieval", The Visual Computer 32,
2016.
"""
