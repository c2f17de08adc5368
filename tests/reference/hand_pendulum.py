"""The motor pendulum's flights in mpmath, by hand: no CasADi, no heyoka, no code of the package.

The laws are those of `problems/motor_pendulum/reference.py`; their Taylor coefficients follow from
Leibniz' rule for products and quotients and from `s' = c theta'`, `c' = -s theta'`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import mpmath as mp

ORDER = 50
Series = list[mp.mpf]


@dataclass(frozen=True, slots=True, kw_only=True)
class HandPendulum:
    """The pendulum at numbers that are doubles, used exactly."""

    numbers: Mapping[str, float]

    def constants(self) -> tuple[mp.mpf, ...]:
        """Return A, B, C, D, E of the laws."""
        p = {name: mp.mpf(value) for name, value in self.numbers.items()}
        return (
            p["I1"] + p["m1"] * p["lc1"] ** 2 + p["m2"] * p["L1"] ** 2 + p["J_rotor"],
            p["I2"] + p["m2"] * p["lc2"] ** 2,
            p["m2"] * p["L1"] * p["lc2"],
            p["m1"] * p["lc1"] + p["m2"] * p["L1"],
            p["m2"] * p["lc2"],
        )

    def series(self, x: Sequence[mp.mpf]) -> list[Series]:
        """Return the Taylor coefficients of the free flow from a state, lowest first."""
        A, B, C, D, E = self.constants()
        g, torque, emf = (mp.mpf(self.numbers[name]) for name in ("g", "K_torque", "K_emf"))
        R, L, Kp, Kd = (mp.mpf(self.numbers[name]) for name in ("R", "L", "Kp", "Kd"))
        th1, th2, w1, w2, i = ([mp.mpf(value)] for value in x)
        both = [th1[0] + th2[0]]
        s1, c1 = [mp.sin(th1[0])], [mp.cos(th1[0])]
        s2, c2 = [mp.sin(th2[0])], [mp.cos(th2[0])]
        s12, c12 = [mp.sin(both[0])], [mp.cos(both[0])]
        det, m11, m12, r1, r2, swirl, square, turn, a1, a2 = ([] for _ in range(10))
        for k in range(ORDER):
            if k > 0:
                for angle, sine, cosine in ((th1, s1, c1), (th2, s2, c2), (both, s12, c12)):
                    slopes = [j * angle[j] for j in range(1, k + 1)]
                    new_sine, new_cosine = (
                        _product(slopes, cosine, k - 1),
                        -_product(slopes, sine, k - 1),
                    )
                    sine.append(new_sine / k)
                    cosine.append(new_cosine / k)
            first = 1 if k == 0 else 0
            det.append(A * B * first - C**2 * _product(c2, c2, k))
            m11.append((A + B) * first + 2 * C * c2[k])
            m12.append(B * first + C * c2[k])
            turn.append(_product([2 * a + b for a, b in zip(w1, w2, strict=True)], w2, k))
            square.append(_product(w1, w1, k))
            swirl.append(_product(s2, square, k))
            r1.append(torque * i[k] + C * _product(s2, turn, k) - g * (D * s1[k] + E * s12[k]))
            r2.append(-C * swirl[k] - g * E * s12[k])
            top1 = B * r1[k] - _product(m12, r2, k)
            top2 = _product(m11, r2, k) - _product(m12, r1, k)
            a1.append((top1 - _product(det[1:], a1, k - 1)) / det[0])
            a2.append((top2 - _product(det[1:], a2, k - 1)) / det[0])
            i.append((-Kp * th1[k] - Kd * w1[k] - R * i[k] - emf * w1[k]) / L / (k + 1))
            th1.append(w1[k] / (k + 1))
            th2.append(w2[k] / (k + 1))
            both.append(th1[-1] + th2[-1])
            w1.append(a1[k] / (k + 1))
            w2.append(a2[k] / (k + 1))
        return [th1, th2, w1, w2, i]

    def next_impact(self, x: Sequence[mp.mpf]) -> tuple[mp.mpf, list[mp.mpf]]:
        """Return duration and end of a flight in which the knee opens first."""
        time, here = mp.mpf(0), [mp.mpf(value) for value in x]
        while True:
            rows = self.series(here)
            # The last terms are worth a unit in the last place.
            size = min((mp.eps / abs(row[-1])) ** (mp.mpf(1) / ORDER) for row in rows)
            if _value(rows[1], size) < 0:
                root = _falling_root(rows[1], size)
                return time + root, [_value(row, root) for row in rows]
            time, here = time + size, [_value(row, size) for row in rows]

    def reset(self, x: Sequence[mp.mpf]) -> list[mp.mpf]:
        """Return the state after an impact: the impulse keeps `M11 w1 + M12 w2`."""
        A, B, C, _, _ = self.constants()
        e = mp.mpf(self.numbers["restitution"])
        th1, _, w1, w2, i = x
        return [th1, mp.mpf(0), w1 + (1 + e) * (B + C) / (A + B + 2 * C) * w2, -e * w2, i]


def _product(a: Series, b: Series, k: int) -> mp.mpf:
    """Return coefficient `k` of a product."""
    return mp.fdot(a[: k + 1], b[k::-1]) if k >= 0 else mp.mpf(0)


def _value(series: Series, time: mp.mpf) -> mp.mpf:
    return mp.polyval(series[::-1], time)


def _falling_root(series: Series, size: mp.mpf) -> mp.mpf:
    """Return the last root before `size`, by bisection and then Newton's method."""
    left, right = size / 2, size
    if _value(series, left) <= 0:
        left = size / 1000
    for _ in range(60):
        middle = (left + right) / 2
        left, right = (middle, right) if _value(series, middle) > 0 else (left, middle)
    root = right
    slopes = [j * c for j, c in enumerate(series)][1:]
    for _ in range(4):
        root -= _value(series, root) / _value(slopes, root)
    return root
