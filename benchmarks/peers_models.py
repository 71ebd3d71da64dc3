"""The models of the three papers, with x0 and P0, and readings for them."""

from __future__ import annotations

import numpy as np

import becalm
from peers_adapters import Floats

SEED = 20260101


def gyroscope() -> becalm.Model:
    """Return the IMU paper's gyroscope with its best tuning (table 2): two states, one channel at 10 kHz."""
    T = 1e-4
    F = np.array([[1, T], [0, 1]])
    Q, R = 1.9674e-7 * np.eye(2), 1.9148e-10
    return becalm.Model(F=F, H=[[1, 0]], Q=Q, R=R, G=T * np.eye(2), x0=np.zeros(2), P0=1e-6 * np.eye(2))


def strain() -> becalm.Model:
    """Return the strain paper's model with noise 0.05: three states, one channel at 10 Hz."""
    T = 0.1
    F = np.array([[1, T, T**2 / 2], [0, 1, T], [0, 0, 1]])
    G = np.array([[T**3 / 6], [T**2 / 2], [T]])
    return becalm.Model(F=F, H=[[1, 0, 0]], Q=1e-4, R=0.05**2, G=G, x0=np.zeros(3), P0=np.eye(3))


def car() -> becalm.Model:
    """Return the car paper's model: three states, three channels at 500 Hz."""
    T = 1 / 500
    F = np.array([[1, T, 0], [0, 1, 0], [0, 0, 1]])
    G = np.array([[T**2 / 2, 0], [T, 0], [0, T]])
    P0 = np.diag([1000.0, 100.0, 100.0])
    return becalm.Model(F=F, H=np.eye(3), Q=1e5 * np.eye(2), R=100 * np.eye(3), G=G, x0=np.zeros(3), P0=P0)


def readings(model: becalm.Model, count: int) -> Floats:
    """Return (count, m) readings: noise, and a slow sine of thirty times its standard deviation."""
    noise = np.sqrt(np.diag(model.R))
    slow = 30 * np.sin(np.linspace(0, 1e-4 * count, count))[:, np.newaxis]
    return (slow + np.random.default_rng(SEED).normal(size=(count, model.channels))) * noise
