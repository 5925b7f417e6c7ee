"""A spec written out: as YAML that runs, and as a hash that names it."""

from __future__ import annotations

import hashlib
import json
import re
from typing import Any

import yaml

try:
    from yaml import CSafeDumper as SafeDumper
except ImportError:  # PyYAML without libyaml: five times slower
    from yaml import SafeDumper  # type: ignore[assignment]

from vmf.spec.base import Model
from vmf.spec.yaml_source import FLOAT


class _Dumper(SafeDumper):
    """PyYAML's safe dumper without aliases, quoting and escaping all text that our loader would misread."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


def _text(dumper: SafeDumper, text: str) -> yaml.ScalarNode:
    # Between single quotes PyYAML folds U+0085 and its like, and they are lost.
    style = None if text.isprintable() else '"'
    return dumper.represent_scalar("tag:yaml.org,2002:str", text, style=style)


_Dumper.add_representer(str, _text)
_Dumper.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(rf"(?:{FLOAT.pattern})\Z"), list("-+.0123456789")
)


def dump(spec: Model) -> str:
    """The resolved spec as YAML, every key in the model's order, unset values as `null`."""
    return yaml.dump(
        spec.model_dump(mode="json"),
        Dumper=_Dumper,
        sort_keys=False,
        allow_unicode=True,
        default_flow_style=None,
        width=100,
    )


def spec_hash(spec: Model) -> str:
    """Ten hexadecimal digits of the SHA-256 of what the spec says, its name apart."""
    # Equal specs have equal hashes: adding zero makes -0.0 the 0.0 it is equal to.
    content = json.loads(
        spec.model_dump_json(exclude={"name"}), parse_float=lambda number: float(number) + 0.0
    )
    canonical = json.dumps(content, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(canonical.encode()).hexdigest()[:10]
