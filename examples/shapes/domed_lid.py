"""A lid whose lower face is hollowed to a shallow dome over the cavity. Lengths in millimetres, z = 0 at its bottom."""

import cadquery as cq


def domed_lid(thickness, radius, hollow, rim):
    """A disc of glass with a spherical hollow: `hollow` deep at the axis, nothing at the radius `rim`."""
    sphere = (rim**2 + hollow**2) / (2 * hollow)
    halfway = (0.5 * rim, hollow - sphere + (sphere**2 - 0.25 * rim**2) ** 0.5)
    return (
        cq.Workplane("XZ").moveTo(0, hollow).threePointArc(halfway, (rim, 0)).lineTo(radius, 0)
        .lineTo(radius, thickness).lineTo(0, thickness).close().revolve(360, (0, 0), (0, 1))
    )
