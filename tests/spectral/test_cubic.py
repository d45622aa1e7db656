"""Cubic finite elements: their matrices derived as rationals, and the functions for which they are exact."""

from __future__ import annotations

from collections import defaultdict
from fractions import Fraction
from math import factorial

import numpy as np
import pytest
import shapes

from pcretrieve.spectral import eigenpairs, laplace_beltrami
from pcretrieve.spectral.elements import (
    CUBIC_REFERENCE,
    LINEAR_REFERENCE,
    ReferenceElement,
    cubic_nodes,
)
from pcretrieve.values import FloatArray

# Polynomials in barycentric coordinates: their powers, and the coefficient.
Polynomial = dict[tuple[int, int, int], Fraction]
Nodes = list[tuple[int, int, int]]

# Barycentric coordinates, times the degree: corners, the way along each side, the centre.
LINEAR_NODES = [(1, 0, 0), (0, 1, 0), (0, 0, 1)]
CUBIC_NODES = [
    *((3, 0, 0), (0, 3, 0), (0, 0, 3)),
    *((2, 1, 0), (1, 2, 0), (0, 2, 1), (0, 1, 2), (1, 0, 2), (2, 0, 1)),
    (1, 1, 1),
]


def product(p: Polynomial, q: Polynomial) -> Polynomial:
    out: Polynomial = defaultdict(Fraction)
    for (a, b, c), x in p.items():
        for (d, e, f), y in q.items():
            out[a + d, b + e, c + f] += x * y
    return out


def mean(p: Polynomial) -> Fraction:
    """(1/a) ∫ λ₀ᵃ λ₁ᵇ λ₂ᶜ = 2 a! b! c! / (a + b + c + 2)!"""
    return sum(
        (
            x
            * Fraction(
                2 * factorial(a) * factorial(b) * factorial(c), factorial(a + b + c + 2)
            )
            for (a, b, c), x in p.items()
        ),
        Fraction(0),
    )


def basis(node: tuple[int, int, int], degree: int) -> Polynomial:
    """One at `node`, zero at all others: Π (degree · λ_k − s) / (node_k − s) over s < node_k."""
    out: Polynomial = {(0, 0, 0): Fraction(1)}
    for k, power in enumerate(node):
        unit = tuple(int(k == j) for j in range(3))
        for s in range(power):
            factor = {
                unit: Fraction(degree, power - s),
                (0, 0, 0): Fraction(-s, power - s),
            }
            out = product(out, factor)  # type: ignore[arg-type]
    return out


def along(p: Polynomial, k: int) -> Polynomial:
    """D_k p: towards corner k + 1, away from corner k."""
    out: Polynomial = defaultdict(Fraction)
    for powers, x in p.items():
        for corner, sign in (((k + 1) % 3, 1), (k, -1)):
            lower = tuple(power - (j == corner) for j, power in enumerate(powers))
            if powers[corner]:
                out[lower] += sign * powers[corner] * x  # type: ignore[index]
    return out


def gram(functions: list[Polynomial]) -> list[list[Fraction]]:
    return [[mean(product(p, q)) for q in functions] for p in functions]


def rational(matrix: FloatArray) -> list[list[Fraction]]:
    """The rationals that these floats are nearest to, with denominators as the elements have them."""
    return [[Fraction(x).limit_denominator(6720) for x in row] for row in matrix]


@pytest.mark.parametrize(
    ("element", "nodes"),
    [(LINEAR_REFERENCE, LINEAR_NODES), (CUBIC_REFERENCE, CUBIC_NODES)],
)
def test_matrices_are_those_of_the_basis_functions(
    element: ReferenceElement, nodes: Nodes
) -> None:
    functions = [basis(node, sum(node)) for node in nodes]
    assert rational(element.mass) == gram(functions)
    numbers = list(range(len(nodes)))
    for k in range(3):
        stiffness = gram([along(p, k) for p in functions])
        assert [[stiffness[i][j] for j in numbers] for i in numbers] == rational(
            element.along
        )
        numbers = element.turn[numbers].tolist()


def test_energy_and_norm_of_a_cubic_function_are_exact() -> None:
    for seed in range(3):
        mesh = shapes.renumbered(shapes.square(3), seed)
        operator = laplace_beltrami(mesh, "cubic")
        nodes = cubic_nodes(mesh)
        places = np.empty((nodes.max() + 1, 3))
        places[nodes] = np.einsum(
            "qk,mkx->mqx", np.array(CUBIC_NODES) / 3, mesh.vertices[mesh.faces]
        )
        x, y, _ = places.T
        u = x**3 + 2 * x * y**2
        # ∫ (3x² + 2y²)² + (4xy)², and ∫ u²
        assert u @ operator.stiffness @ u == pytest.approx(
            9 / 5 + 12 / 9 + 4 / 5 + 16 / 9, rel=1e-13
        )
        assert u @ operator.mass @ u == pytest.approx(1 / 7 + 4 / 15 + 4 / 15, rel=1e-13)


def test_lumped_mass_costs_two_orders() -> None:
    operators = (
        laplace_beltrami(shapes.square(n), "cubic", mass="lumped") for n in (6, 12)
    )
    coarse, fine = (
        eigenpairs(operator, 4).eigenvalues[1] / np.pi**2 - 1 for operator in operators
    )
    assert np.log2(coarse / fine) == pytest.approx(4, abs=0.2)
