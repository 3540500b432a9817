"""What stands on the pallet: one placed box, as the readers give it and as the physics takes it."""

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

Finite = Annotated[float, Field(allow_inf_nan=False, strict=True)]
Point3 = tuple[Finite, Finite, Finite]
Place = Annotated[float, Field(ge=-100.0, le=100.0, allow_inf_nan=False, strict=True)]
EdgeLength = Annotated[float, Field(gt=0.0, le=10.0, allow_inf_nan=False, strict=True)]


class Package(BaseModel):
    """A rigid box, placed upright in frame ``sled`` (x forward, y left, z up) and turned about z.

    A box that a palletising file lays on its side is given by its edge lengths as it lies.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    id: str = Field(min_length=1, max_length=120, description="unique name within the load")
    size_m: tuple[EdgeLength, EdgeLength, EdgeLength] = Field(
        description="edge lengths along the package's own x, y, z as it stands [m]"
    )
    mass_kg: float = Field(gt=0.0, le=5000.0, allow_inf_nan=False, strict=True, description="mass [kg]")
    position_m: tuple[Place, Place, Place] = Field(description="centre in frame sled [m]")
    yaw_deg: Finite = Field(default=0.0, description="turn about z, counter-clockwise from above [deg]")
    surface: str = Field(default="cardboard", description="surface name, for friction")
    kind: Literal["package", "interlayer"] = Field(
        default="package", description="an interlayer is a sheet between two layers"
    )
    layer: int | None = Field(
        default=None, ge=1, description="layer number from below, where the source names it"
    )
