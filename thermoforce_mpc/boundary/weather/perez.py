"""The anisotropic sky of Perez et al. (1990): what of the diffuse light comes from round the sun and from the horizon.

Written out because two traits of the BOPTEST test case matter by a tenth of a kelvin and pvlib has neither: its release
of the IBPSA library takes the sky's clearness from *horizontal* beam light (corrected there in May 2021, issue 1477),
and its sky keeps shining for as long as the weather file says so, also when the sun has just set.
"""

from __future__ import annotations

import numpy as np

from thermoforce_mpc.data import Array

_SOLAR_CONSTANT_W_M2 = 1367.0
# Weight of the zenith angle in the clearness, 1/rad³.
_KAPPA = 5.534e-6 * (180.0 / np.pi) ** 3
_LEAST_DIFFUSE_W_M2 = 1e-4
_LEAST_COS_ZENITH = np.cos(np.deg2rad(85.0))

# Upper edges of the first seven bins of clearness, and per bin F11, F12, F13, F21, F22, F23 (Perez 1990, table 6, with
# the digits of the IBPSA library).
_EDGES = np.array([1.065, 1.23, 1.50, 1.95, 2.80, 4.50, 6.20])
_COEFFICIENTS = np.array(
    [
        [-0.0083117, 0.5877285, -0.0620636, -0.0596012, 0.0721249, -0.0220216],
        [0.1299457, 0.6825954, -0.1513725, -0.0189325, 0.0659650, -0.0288748],
        [0.3296958, 0.4868735, -0.2210958, 0.0554140, -0.0639588, -0.0260542],
        [0.5682053, 0.1874525, -0.2951290, 0.1088631, -0.1519229, -0.0139754],
        [0.8730280, -0.3920403, -0.3616149, 0.2255647, -0.4620442, 0.0012448],
        [1.1326077, -1.2367284, -0.4118494, 0.2877813, -0.8230357, 0.0558651],
        [1.0601591, -1.5999137, -0.3589221, 0.2642124, -1.1272340, 0.1310694],
        [0.6777470, -0.3272588, -0.2504286, 0.1561313, -1.3765031, 0.2506212],
    ]
)


def sky_diffuse(diffuse_W_m2: Array, beam_W_m2: Array, zenith: Array, cos_incidence: Array, tilt: float) -> Array:
    """Diffuse irradiance from the sky on a plane, W/m²; arrays of one shape.

    Args:
        diffuse_W_m2: diffuse horizontal irradiance.
        beam_W_m2: beam light by which the sky's clearness is judged. Perez means direct normal; the test case means
            the beam's part of the global horizontal irradiance.
        zenith: of the sun, rad; may exceed π/2.
        cos_incidence: cosine of the sun's angle to the plane's normal.
        tilt: of the plane, rad.
    """
    bounded = np.maximum(diffuse_W_m2, _LEAST_DIFFUSE_W_M2)
    cube = _KAPPA * zenith**3
    clearness = ((bounded + beam_W_m2) / bounded + cube) / (1.0 + cube)
    brightness = np.minimum(diffuse_W_m2 * relative_air_mass(zenith) / _SOLAR_CONSTANT_W_M2, 1.0)
    f = _COEFFICIENTS[np.searchsorted(_EDGES, clearness)]
    circumsolar = np.maximum(f[..., 0] + f[..., 1] * brightness + f[..., 2] * zenith, 0.0)
    horizon = f[..., 3] + f[..., 4] * brightness + f[..., 5] * zenith
    towards_sun = np.maximum(cos_incidence, 0.0) / np.maximum(np.cos(zenith), _LEAST_COS_ZENITH)
    dome = 0.5 * (1.0 - circumsolar) * (1.0 + np.cos(tilt))
    share = dome + circumsolar * towards_sun + horizon * np.sin(tilt)
    return np.asarray(np.maximum(diffuse_W_m2 * share, 0.0))


def relative_air_mass(zenith: Array) -> Array:
    """Path through the atmosphere over that from the zenith (Kasten 1966); the sun no lower than the horizon."""
    limited = np.minimum(zenith, np.pi / 2)
    return np.asarray(1.0 / (np.cos(limited) + 0.15 * (93.9 - np.rad2deg(limited)) ** -1.253))
