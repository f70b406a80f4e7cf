"""Stored models that carry the hash of their own content, so that a line changed by hand is noticed."""

from __future__ import annotations

import hashlib
import json
from typing import Any

from pydantic import BaseModel, ConfigDict, model_validator
from pydantic_core import from_json

SEAL = "content_sha256"  # the last field of the JSON, and no field of the model


class StoredModel(BaseModel):
    """A model with no other fields than its own, whose JSON has infinite numbers and nan as texts."""

    model_config = ConfigDict(frozen=True, extra="forbid", ser_json_inf_nan="strings")


class SealedModel(StoredModel):
    """A model that `sealed_json` writes with its hash; JSON with another hash, or without one, is refused."""

    def sealed_json(self) -> bytes:
        """The model as JSON on one line, its hash last."""
        content = self.model_dump_json()
        return f'{content[:-1]},"{SEAL}":"{content_sha256(from_json(content))}"}}'.encode()

    @model_validator(mode="before")
    @classmethod
    def _as_sealed(cls, fields: Any, info: Any) -> Any:
        if not isinstance(fields, dict) or info.mode != "json":
            return fields
        if SEAL not in fields:
            raise ValueError(f"it has no {SEAL}, the hash that this version writes")
        content = {name: value for name, value in fields.items() if name != SEAL}
        if fields[SEAL] != content_sha256(content):
            raise ValueError(f"it was changed after it was written, for its {SEAL} is that of other content")
        return content


def content_sha256(content: dict[str, Any]) -> str:
    """Hash of values of JSON, whatever the order of their keys and the space between them."""
    return hashlib.sha256(json.dumps(content, sort_keys=True, separators=(",", ":")).encode()).hexdigest()
