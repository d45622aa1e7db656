"""The options for common sources of scans, by name."""

from __future__ import annotations

from typing import Any

__all__ = ["PRESETS"]

# The options that differ from the defaults for scans of a common source. The measurements behind each preset
# are in docs/decisions.md, PRESETS.
PRESETS: dict[str, dict[str, dict[str, Any]]] = {
    # A ring of cameras around a person. People have genus 0: handles appear only where limbs touch, and are
    # cut. All scans are in the unit of the scanner, so that sizes are comparable too.
    "body-scanner": {"surface": {"genus": "sphere"}, "signature": {"size_weight": 6.0}},
    # A hand-held scanner moved around the body: many outliers, and large holes in places that it missed.
    "handheld": {
        "scan": {"outlier_std": 1.5, "flood_gap": 0.03},
        "surface": {"gap": 0.03},
    },
    # Frames of a depth sensor: noise of 0.3 % of the diagonal and more, and a room around the body.
    "depth-camera": {
        "scan": {"voxel": 0.004, "outlier_std": 1.5, "normal_neighbors": 30, "flood_gap": 0.03},
        "surface": {"cell": 0.006, "gap": 0.03},
        "merge": {"sensor": "origin", "background": "planes", "keep_largest": True, "voxel": 0.003},
    },
    # Meshes from modelling software, or cleaned by hand: repaired, but not reconstructed.
    "clean-mesh": {"surface": {"mode": "keep"}},
    # The setting of Ye and Yu for the non-rigid track of SHREC'11.
    "paper": {
        "signature": {"method": "r-bihdm", "n_values": 23, "scale": "relative"},
        "retrieval": {"distance": "d2", "whitening": "none"},
        "surface": {"mode": "keep"},
    },
    # The textbook chain, for comparison: normals oriented along a minimum spanning tree, screened Poisson
    # reconstruction by Open3D, remeshing by fTetWild, linear elements, and R-BiHDM signatures, whitened
    # by PCA.
    "classic": {
        "scan": {"orientation": "tangent-plane"},
        "surface": {"method": "poisson"},
        "remesh": {"method": "tetwild"},
        "spectral": {"element": "linear"},
        "signature": {"method": "r-bihdm"},
        "retrieval": {"whitening": "pca"},
    },
}
