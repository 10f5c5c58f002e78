"""The oracle of Source C: an emitter's density on a grid, with the wrapped normal likelihood.

Nothing is linearised and no lobe is chosen: the density of the first scan is laid out over every
ambiguity integer, fine in phase and coarse in range, and multiplied by each later likelihood
p(psi, rate | x) = sum_b N([psi + 2 pi b, rate]; h(x), R(x)).
"""

from __future__ import annotations

import numpy as np

TURN = 2.0 * np.pi


class Observer:
    """An aircraft flying east at `speed` m/s from the origin, baseline along its path."""

    def __init__(self, K, speed, phase, rate, position, velocity):
        self.K, self.speed = K, speed
        self.phase, self.rate, self.position, self.velocity = phase, rate, position, velocity

    def look(self, x, y, time):
        """Phase and rate of a fixed emitter at (x, y), and the entries of R, by hand."""
        K, v = self.K, self.speed
        x = x - v * time
        r2 = x * x + y * y
        r = np.sqrt(r2)
        phase, rate = K * x / r, -K * v * y * y / (r2 * r)
        px, py = K * y * y / (r2 * r), -K * x * y / (r2 * r)
        qx, qy = (
            3.0 * K * v * x * y * y / (r2 * r2 * r),
            K * v * y * (y * y - 2 * x * x) / (r2 * r2 * r),
        )
        s, w = self.position**2, self.velocity**2
        a = self.phase**2 + s * (px * px + py * py)
        b = s * (px * qx + py * qy)
        c = self.rate**2 + s * (qx * qx + qy * qy) + w * (px * px + py * py)
        return phase, rate, a, b, c


def first(observer, psi, rate, bearing, reach, fine=41, coarse=101, wide=4.5):
    """Grid and log density after the first scan: equal chances for every integer in the window."""
    K, v = observer.K, observer.speed
    low = np.ceil((K * np.cos(bearing + reach) - psi) / TURN)
    high = np.floor((K * np.cos(bearing - reach) - psi) / TURN)
    turns = np.arange(low, high + 1)[:, None, None]
    g = np.linspace(-wide, wide, fine)[None, :, None]
    h = np.linspace(-wide, wide, coarse)[None, None, :]
    middle = np.arccos((psi + TURN * turns) / K)
    r = -K * v * np.sin(middle) ** 2 / rate
    a = observer.look(r * np.cos(middle), r * np.sin(middle), 0.0)[2]
    theta = np.arccos((psi + TURN * turns + g * np.sqrt(a)) / K)
    r = -K * v * np.sin(theta) ** 2 / rate
    # dR/d rate = -R/rate; along-track speed dR/dv = R/v, across (v sin - vy cos): R cot(theta)/v
    sd = r * np.sqrt((observer.rate / rate) ** 2 + (observer.velocity / (v * np.sin(theta))) ** 2)
    r = r + h * sd
    return r * np.cos(theta), r * np.sin(theta), np.broadcast_to(-0.5 * (g**2 + h**2), r.shape)


def update(observer, x, y, log_p, psi, rate, time):
    """Multiply by the wrapped normal likelihood of one scan."""
    phase, expected, a, b, c = observer.look(x, y, time)
    nu, mu = np.mod(psi - phase + np.pi, TURN) - np.pi, rate - expected
    det = a * c - b * b
    each = [
        -0.5 * (c * (nu + TURN * k) ** 2 - 2.0 * b * (nu + TURN * k) * mu + a * mu**2) / det
        for k in (-1, 0, 1)
    ]
    return log_p + np.logaddexp.reduce(each, axis=0) - 0.5 * np.log(det)


def moments(x, y, log_p):
    """Mean (2,) and covariance (2, 2) of the density."""
    p = np.exp(log_p - log_p.max())
    p /= p.sum()
    m = np.array([(p * x).sum(), (p * y).sum()])
    dx, dy = x - m[0], y - m[1]
    xy = (p * dx * dy).sum()
    return m, np.array([[(p * dx * dx).sum(), xy], [xy, (p * dy * dy).sum()]])
