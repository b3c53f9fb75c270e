"""Drag of a vehicle of unknown drag, from its mass."""

import msgspec

from companion.core.vehicle.airframe import Airframe, Drag


def with_drag_over_mass_of(airframe: Airframe, mass_kg: float) -> Airframe:
    """Return an airframe with the drag over mass of a vehicle like it of another mass.

    Proportional to mass^-0.25 over 0.4 to 58 kg, to 18 % rms (params/airframes/generic.toml).
    """
    factor = (mass_kg / airframe.mass.empty_kg) ** -0.25
    keys = [key for key in Drag.__struct_fields__ if key.startswith(("linear", "quadratic"))]
    scaled = {key: factor * getattr(airframe.drag, key) for key in keys}
    return msgspec.structs.replace(airframe, drag=msgspec.structs.replace(airframe.drag, **scaled))
