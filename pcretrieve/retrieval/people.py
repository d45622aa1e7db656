"""The metric of people: what scans of one person differ by, weighed against what people differ by.

The coordinates of a scan are x = μ + y + e, in which y belongs to the person, and e to the pose, the sensor
and the reconstruction. Let S_w be the covariance of e, and S_t that of x. The difference d of two scans of
one person has the covariance 2 S_w, that of scans of two people 2 S_t. The logarithm of the ratio of the two
likelihoods of d is, up to constants, −dᵀ M d with

    M = S_w⁻¹ − S_t⁻¹

which is the metric KISSME [1]_. It is that of linear discriminants: in directions in which people do not
differ, S_t = S_w, and differences do not count. Other whitenings would amplify these directions.

Both covariances are those of raw scans of simulated people in several poses by several sensors, and of
coarser meshes of scans (people.txt): the distance of two scans of people hardly changes when others are added
to a catalogue.

Some of the scans that teach are damaged, and what a missing limb changes in people of another body model is
added: directions in which a missing limb, a hole or a thin side moves coordinates count less.

References
----------
.. [1] M. Köstinger, M. Hirzer, P. Wohlhart, P. M. Roth and H. Bischof, "Large scale metric learning from
   equivalence constraints", CVPR 2012.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from importlib import resources
from typing import NamedTuple

import numpy as np

from pcretrieve.options import SignatureOptions, fused_names
from pcretrieve.retrieval.distances import Positions
from pcretrieve.values import FloatArray

# mean (214,), within and total (214, 214), limbs (214, 12), scale (214,): the moments of the coordinates of
# hapt, of 59 values of r-bihdm and of log area, divided by the scale of each. limbless_mean (23,), limbless
# (23, 23): those of 23 values of r-bihdm of scans without a limb. Of symmetric matrices the upper triangles.
# And the fields of `Reference`. Written by scripts/benchmark people --learn.
SAMPLE = "people.npz"
SYMMETRIC = ("within", "total", "limbless")
N_VALUES = 23

# Where the coordinates of a descriptor begin, how many of r-bihdm there are, and of how many modes they are.
BEGINS = {"hapt": 0, "r-bihdm": 154}
MOST_VALUES = 59
N_MODES = 60

# Scans are those of people if they are at most this unlike the simulated ones, and well known if they are at
# most KNOWN unlike: see `People.unlikeness` and docs/decisions.md, people.
ALIKE = 5.0
KNOWN = 1.3

# Share of the scans that are less unlike: half of a collection of people and animals is like people.
LESS_UNLIKE = 0.75

# Least share of labelled scans by which the metric is calibrated: they show what their sensor changes.
LEAST_SHARE = 0.05

# How much of what a missing limb changes is added to what a catalogue shows: see docs/decisions.md, limbless.
LIMBS_ADDED = 0.6

# A scan that is more unlike people, whole and without a limb, tells nothing of limbs: hands and animals that
# seem to lack one are 2 and 3 unlike. See docs/decisions.md, limbs by the form.
ALIKE_LIMBLESS = 1.9

# False-match rates at which distances are known.
RATES = np.concatenate([[0.0], np.geomspace(1e-4, 1, 41)])

# Number of scans, or up to twice as many, from which it is found how unlike they are: it needs no more.
COMPARED = 10_000


class Reference(NamedTuple):
    """What distances of scans of people mean who did not teach the metric.

    same: (s,) float64, quantiles of the distances of two scans of one person, at equal steps.
    apart: (r,) float64, those of two people, at `RATES`.
    coefficients: (3,) float64, of the regression of certainty: see `pcretrieve.retrieval.scores`.
    information: (3, 3) float64, what a query tells of them on average: the Hessian of the loss.
    """

    same: FloatArray
    apart: FloatArray
    coefficients: FloatArray
    information: FloatArray


class People(NamedTuple):
    """The mean (L,) of the coordinates of people, their covariance within people and in total, (L, L).

    limbs: (L, l) float64, whose product with its transpose is the second moment of what a missing limb
        changes.
    compared: the coordinates by which neighbours in a catalogue are found: those of hapt, if there are any.
    reference: what distances mean in the metric; for the default descriptor, by the form alone.
    """

    mean: FloatArray
    within: FloatArray
    total: FloatArray
    limbs: FloatArray
    compared: Positions
    reference: Reference | None = None

    def unlikeness(self, coordinates: FloatArray) -> float:
        """How far some scans (N, L) are from the mean: the variance, in units of that of simulated scans.

        That of the scan of which three quarters of the others are nearer.
        """
        apart = coordinates[:: max(1, len(coordinates) // COMPARED)] - self.mean
        variances = (apart * np.linalg.solve(self.total, apart.T).T).mean(axis=1)
        return float(np.quantile(variances, LESS_UNLIKE))

    def adapted(self, own: FloatArray, share: float) -> People:
        """With the covariance (L, L) of differences within a catalogue, in any unit, as a share of S_w.

        A catalogue of whole scans does not show what a missing limb changes, which is added.
        """
        scale = np.trace(self.within) / np.trace(own)
        shown = scale * own + LIMBS_ADDED * self.limbs @ self.limbs.T
        within = (1 - share) * self.within + share * shown
        return self._replace(within=within, total=self.total - self.within + within)

    @property
    def metric(self) -> FloatArray:
        """M (L, L), positive semidefinite."""
        return np.linalg.inv(self.within) - np.linalg.inv(self.total)

    def unusual(self, root: FloatArray) -> FloatArray:
        """Q (L, L), by which yᵀ Q y tells how unusual a person is; root: R, the symmetric root of M.

        It is the mean square of the expected part of the person, S_b S_t⁻¹ (x − μ) with S_b = S_t − S_w, in
        units of the variance S_b, divided by its mean over people; with y = R (x − μ)

            Q = (I − R S_w R) / tr(R S_w R)
        """
        within = root @ self.within @ root
        return np.asarray((np.eye(len(within)) - within) / np.trace(within))


def limbless_ratio(values: FloatArray) -> float | None:
    """How much more a form is like those of people without a limb, or the head, than like whole ones.

    It is the logarithm of the ratio p₁(x) / p₀(x) of two normal densities of x, the coordinates of R-BiHDM:
    of scans of people without the end of a limb, or the head, and of all scans of people.

    values: (23,) of R-BiHDM, in units of the squared area.
    Returns None if the form is unlike both: then it need not be a person's.
    """
    sample = installed()
    some = slice(BEGINS["r-bihdm"], BEGINS["r-bihdm"] + N_VALUES)
    place = np.log(values) / sample["scale"][some]
    squares, densities = [], []
    for mean, covariance in (
        (sample["mean"][some], sample["total"][some, some]),
        (sample["limbless_mean"], sample["limbless"]),
    ):
        apart = place - mean
        squares.append(apart @ np.linalg.solve(covariance, apart))
        densities.append(-(squares[-1] + np.linalg.slogdet(covariance)[1]) / 2)
    if min(squares) > ALIKE_LIMBLESS * N_VALUES:
        return None
    return float(densities[1] - densities[0])


def unpacked(arrays: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
    """The arrays of `SAMPLE` as float64, with whole matrices."""
    sample = {name: arrays[name].astype(np.float64) for name in arrays}
    for name in SYMMETRIC:
        triangle = sample[name]
        n = int(np.sqrt(2 * len(triangle)))
        upper = np.triu_indices(n)
        sample[name] = np.empty((n, n))
        sample[name][upper] = sample[name].T[upper] = triangle
    return sample


@cache
def installed() -> dict[str, FloatArray]:
    """The arrays of `SAMPLE`."""
    return unpacked(np.load(str(resources.files(__package__).joinpath(SAMPLE))))


def people(
    options: SignatureOptions, sample: Mapping[str, FloatArray] | None = None
) -> People | None:
    """The moments of the coordinates of signatures by some options; None if they are not known.

    sample: the arrays of `SAMPLE`, by default; or others that scripts/benchmark people has learned.
    """
    names = fused_names(options.method)
    is_known = set(names) <= set(BEGINS) and len(set(names)) == len(names)
    is_known &= "r-bihdm" not in names or options.n_values <= MOST_VALUES
    if not is_known or options.n_modes != N_MODES or options.scale != "area":
        return None
    sample = sample or installed()
    length = {"hapt": BEGINS["r-bihdm"], "r-bihdm": options.n_values}
    chosen = np.concatenate([np.arange(length[name]) + BEGINS[name] for name in names])
    scale = np.ones(len(chosen)) if len(names) > 1 else sample["scale"][chosen]
    if options.size_weight:
        chosen, scale = np.append(chosen, -1), np.append(scale, options.size_weight)
    is_default = names == tuple(BEGINS) and options.n_values == N_VALUES
    among = np.ix_(chosen, chosen)
    within, total = (
        sample[name][among] * np.outer(scale, scale) for name in ("within", "total")
    )
    known = None
    if is_default and not options.size_weight and "same" in sample:
        known = Reference(*(sample[name] for name in Reference._fields))
    mean = sample["mean"][chosen] * scale
    limbs = sample["limbs"][chosen] * scale[:, np.newaxis]
    # Limbs that are not parted change the distances along a surface, and so R-BiHDM, more than a class does.
    # The size, at −1, is compared with hapt.
    compared = np.flatnonzero((chosen < BEGINS["r-bihdm"]) | ("hapt" not in names))
    return People(mean, within, total, limbs, compared, known)
