"""Base of all fleet messages: versioned, without unknown fields, NaN or infinity."""

import math
from typing import Annotated

import msgspec
from msgspec import Meta

from companion.core.base.errors import LeewayError

VERSION = 2

Name = Annotated[str, Meta(pattern=r"^[a-z0-9][a-z0-9_-]{0,31}\Z")]
Key = Annotated[str, Meta(pattern=r"^[0-9a-f]{64}\Z")]
"""Public half of an Ed25519 key, 64 hex digits."""

RosterStamp = Annotated[str, Meta(pattern=r"^[1-9][0-9]{0,14}:[0-9a-f]{16}\Z")]
"""Number and hash of the roster in force."""


class WireMessage(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A message with its version `v`; raises LeewayError for a number that is not finite."""

    v: int = VERSION
    """Version of the messages."""

    def __post_init__(self) -> None:
        for name in self.__struct_fields__:
            value = getattr(self, name)
            if isinstance(value, float) and not math.isfinite(value):
                raise LeewayError(f"{name}: expected a finite number")
