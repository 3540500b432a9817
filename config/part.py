"""The base of everything that stands in a scene file."""

from pydantic import BaseModel, ConfigDict


class Part(BaseModel):
    """Base of every scene part: unknown keys are refused, values don't change."""

    # A bounded text is also checked to be Unicode: half of a surrogate pair could not be written again.
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, str_max_length=10_000)
