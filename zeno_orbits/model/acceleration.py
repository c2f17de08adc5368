"""The acceleration of a mechanism on its holonomic constraints."""

from __future__ import annotations

import casadi as ca

from zeno_orbits.model.lagrangian import HybridLagrangian


def accelerate(lagrangian: HybridLagrangian, force: ca.SX) -> tuple[ca.SX, ca.SX]:
    r"""Return the inverse mass on the holonomic constraints and the free acceleration.

    .. math:: W = M^{-1} - M^{-1} H^\top (H M^{-1} H^\top)^{-1} H M^{-1},\qquad
        a = W (F - \mathrm{bias}) - M^{-1} H^\top (H M^{-1} H^\top)^{-1} \dot H v

    with :math:`H = \partial\eta / \partial q` (theory (1.6)).
    """
    q, v, eta = lagrangian.q, lagrangian.v, lagrangian.holonomic
    inverse_mass = ca.inv(lagrangian.mass_matrix)
    net_force = force - lagrangian.bias
    if eta.numel() == 0:
        return inverse_mass, ca.mtimes(inverse_mass, net_force)
    jacobian = ca.jacobian(eta, q)
    response = ca.mtimes(inverse_mass, jacobian.T)
    gain = ca.mtimes(response, ca.inv(ca.mtimes(jacobian, response)))
    constrained = inverse_mass - ca.mtimes(gain, response.T)
    drift = ca.jtimes(ca.mtimes(jacobian, v), q, v)
    return constrained, ca.mtimes(constrained, net_force) - ca.mtimes(gain, drift)
