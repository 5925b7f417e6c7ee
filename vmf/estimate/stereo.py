"""The equations of a centre in both cameras at once, which share their lifts (§4).

A stereo observation gives four rows, `[x̄ 0 | x x̄]` and `[0 x̄ | y x̄]` in each camera, all with the same x̄.
One orthogonal transformation therefore triangularises the lifts of all four, and what it leaves below
of the products `x x̄`, `y x̄` is triangularised once more per camera:

    [ x̄ | x_L x̄ | y_L x̄ | x_R x̄ | y_R x̄ ]  →  [ T | X_L | Y_L | X_R | Y_R ]   and   S_L, S_R

The factor of a camera's augmented rows (§3.3) is then, but for the signs of the error columns,

    [ T 0 X ]
    [ 0 T Y ]
    [ 0 0 S ]

Blocks of k+1 columns take the place of a factor of 3k+3: far less work, and square roots all the way.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from vmf.estimate.rows import triangle

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]

Cameras = Literal["left", "right", "both"]
# Where these stand among the two.
CAMERAS: Mapping[Cameras, slice] = MappingProxyType(
    {"left": slice(0, 1), "right": slice(1, 2), "both": slice(0, 2)}
)

# With a condition number below this, no singular value comes near the rank tolerance (1e-11).
_SAFELY_REGULAR = 1e10


@dataclass(frozen=True)
class StereoEquations:
    """Equations of centres in C cameras with leading batch axes (…), triangular or not.

    Attributes
    ----------
    lifts : (…, m, 1+2C, k+1) rows `x̄, x_L x̄, y_L x̄, x_R x̄, y_R x̄`, or what a rotation makes of them.
    rest : (…, C, p, k+1) rows of the left and of the right camera that have products only.
    """

    lifts: Floats
    rest: Floats

    @classmethod
    def none(cls, n: int, *batch: int, cameras: int = 2) -> StereoEquations:
        """Return the triangular form of no equations, for lifts of length n = k+1."""
        return cls(np.zeros((*batch, n, 1 + 2 * cameras, n)), np.zeros((*batch, cameras, n, n)))

    @classmethod
    def of(cls, x_bar: Floats, u: Floats) -> StereoEquations:
        """Return the equations of lifts (…, m, k+1) and of the pixels (…, m, 2, 2) of both cameras."""
        *batch, m, n = x_bar.shape
        lifts = np.empty((*batch, m, 5, n))
        lifts[..., 0, :] = x_bar
        np.multiply(u.reshape(*batch, m, 4, 1), x_bar[..., None, :], out=lifts[..., 1:, :])
        return cls(lifts, np.zeros((*batch, 2, 0, n)))

    @property
    def n(self) -> int:
        """Length k+1 of a lift."""
        return int(self.lifts.shape[-1])

    @property
    def cameras(self) -> int:
        """Number C of cameras."""
        return int(self.rest.shape[-3])

    @property
    def products(self) -> Floats:
        """The products (…, m, C, 2, k+1) of the cameras' x and y with the lifts."""
        return self.lifts[..., 1:, :].reshape(*self.lifts.shape[:-2], self.cameras, 2, self.n)

    def of_cameras(self, which: Cameras) -> StereoEquations:
        """Return those of some cameras, out of both; what is triangular stays so."""
        if which == "both":
            return self
        some = CAMERAS[which]
        # The left camera's columns are a view.
        columns = slice(0, 3) if which == "left" else [0, 3, 4]
        return StereoEquations(self.lifts[..., columns, :], self.rest[..., some, :, :])

    def __getitem__(self, centres: Ints | slice) -> StereoEquations:
        return StereoEquations(self.lifts[centres], self.rest[centres])

    def with_others(self, others: StereoEquations) -> StereoEquations:
        """Return these equations and further ones of the same centres, in triangular form."""
        lifts = np.concatenate([self.lifts, others.lifts], axis=-3)
        rest = np.concatenate([self.rest, others.rest], axis=-2)
        return StereoEquations(lifts, rest).triangular()

    def pooled(self, members: Ints, weight: Floats) -> StereoEquations:
        """Return, for groups (G, c) of centres, the equations of all members as one, in triangular form.

        Equations are multiplied by the weights (G, c) of their centres; zero leaves them out.
        """
        w, G = weight[..., None, None, None], len(members)
        lifts, rest = w * self.lifts[members], w * self.rest[members]
        rest = rest.swapaxes(1, 2)
        lifts = lifts.reshape(G, -1, *lifts.shape[-2:])
        return StereoEquations(lifts, rest.reshape(G, self.cameras, -1, self.n)).triangular()

    def seen_from(self, L: Floats, u: Floats) -> StereoEquations:
        """Return the equations of the same observations paired with other centres: not triangular.

        They are linear in `[x̄; x x̄; y x̄]`: every block of columns is multiplied by `L_cᵀ`, and pixels count
        from the centre's (§4).

        Parameters
        ----------
        L : (…, k+1, k+1) closure matrices of the centres' poses.
        u : (…, C, 2) the centres' pixels in the cameras.
        """
        *batch, m, blocks, n = self.lifts.shape
        L_T = np.swapaxes(L, -1, -2)
        lifts = (self.lifts.reshape(*batch, blocks * m, n) @ L_T).reshape(*L.shape[:-2], m, blocks, n)
        lifts[..., 1:, :] -= u.reshape(*u.shape[:-2], 1, blocks - 1, 1) * lifts[..., :1, :]
        return StereoEquations(lifts, self.rest @ L_T[..., None, :, :])

    def triangular(self) -> StereoEquations:
        """Return equations with the same inner products: k+1 rows of lifts, k+1 of products."""
        *batch, m, blocks, n = self.lifts.shape
        C = self.cameras
        R = triangle(self.lifts.reshape(*batch, m, blocks * n))
        below = R[..., n:, n:]
        rest = self.rest
        if below.shape[-2]:
            # x and y of a camera are equations of the same unknowns.
            below = below.reshape(*batch, -1, C, 2, n).swapaxes(-4, -3).reshape(*batch, C, -1, n)
            rest = np.concatenate([rest, below], axis=-2)
        return StereoEquations(
            _of_height(n, R[..., :n, :]).reshape(*batch, n, blocks, n), _of_height(n, triangle(rest))
        )

    @property
    def full(self) -> Bools:
        """Which triangular equations (…,) have no zero on the diagonal of any unknown."""
        C = self.rest[..., :-1, :-1]
        return np.asarray(_full_diagonal(self.lifts[..., 0, :]) & _full_diagonal(C).all(axis=-1))

    def factors(self) -> Floats:
        """Return the factors (…, C, 3k+3, 3k+3) of the augmented rows, from triangular equations."""
        n, C, batch = self.n, self.cameras, self.lifts.shape[:-3]
        R = np.zeros((*batch, C, 3, n, 3, n))
        R[..., 0, :, 0, :] = R[..., 1, :, 1, :] = self.lifts[..., None, :, 0, :]
        R[..., :2, :, 2, :] = _by_camera(self.products) * _signs(n)
        R[..., 2, :, 2, :] = self.rest * _signs(n)
        return R.reshape(*batch, C, 3 * n, 3 * n)

    def least_squares(self) -> tuple[Floats, Bools]:
        """Solve triangular equations with the constant of c fixed to 1, by substitution (Eq. 3.47).

        Returns
        -------
        rows : (…, C, 3, k+1) `a, b, c` of the cameras.
        regular : (…, C) where these are the solution. Elsewhere the equations are rank-deficient, or nearly
            so, and only the singular values of `factors` can tell.
        """
        n, batch = self.n, self.lifts.shape[:-3]
        T, C, c = self.lifts[..., 0, :], self.rest[..., :-1, :-1], self.rest[..., :-1, -1:]
        full_T, full_C = _full_diagonal(T), _full_diagonal(C)
        if not (full_T.all() and full_C.all()):
            # Anything may stand for a singular triangle: what is solved with it is not used.
            T = np.where(full_T[..., None, None], T, np.eye(n))
            C = np.where(full_C[..., None, None], C, np.eye(n - 1))
        # LU leaves a triangular matrix as it is, so that `solve` is back substitution.
        with np.errstate(over="ignore", invalid="ignore"):
            of_C = np.linalg.solve(C, np.concatenate([np.broadcast_to(np.eye(n - 1), C.shape), c], axis=-1))
            columns = self.lifts.reshape(*batch, n, -1)[..., n:]
            of_T = np.linalg.solve(T, np.concatenate([np.broadcast_to(np.eye(n), T.shape), columns], axis=-1))
            XY = _by_camera(of_T[..., n:].reshape(*batch, n, self.cameras, 2, n))
            # The error columns of c stand with a minus (Eq. 3.46).
            c = -of_C[..., -1]
            rows = np.ones((*batch, self.cameras, 3, n))
            rows[..., :2, :] = XY[..., -1] + (XY[..., :-1] @ c[..., None, :, None])[..., 0]
            rows[..., 2, :-1] = c
            # Frobenius norms of the triangle's blocks and of its inverse's bound the condition number.
            size = 2.0 * _squares(T)[..., None] + _squares(C) + _squares(columns)[..., None]
            of_rest = _squares(of_C[..., :-1]) * (1.0 + _squares(of_T[..., n:])[..., None])
            gain = 2.0 * _squares(of_T[..., :n])[..., None] + of_rest
            regular = full_T[..., None] & full_C & (size * gain < _SAFELY_REGULAR**2)
        return rows, np.asarray(regular)


def _by_camera(products: Floats) -> Floats:
    """Return products (…, C, 2, m, k+1) from (…, m, C, 2, k+1)."""
    return products.swapaxes(-4, -2).swapaxes(-4, -3)


def _of_height(n: int, R: Floats) -> Floats:
    """Return triangles (…, r, w) of at most n rows with zeros for the rows that lack."""
    if R.shape[-2] == n:
        return R
    full = np.zeros((*R.shape[:-2], n, R.shape[-1]))
    full[..., : R.shape[-2], :] = R
    return full


def _signs(n: int) -> Floats:
    """Return the signs of the error columns: `−e ℓ` stands with c, `e` on the right (Eq. 3.46)."""
    signs = np.full(n, -1.0)
    signs[-1] = 1.0
    return signs


def _full_diagonal(A: Floats) -> Bools:
    return np.asarray((A.diagonal(axis1=-2, axis2=-1) != 0.0).all(axis=-1))


def _squares(A: Floats) -> Floats:
    return np.asarray(np.einsum("...ij,...ij->...", A, A))
