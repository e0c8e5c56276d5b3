"""The published JSON schemas."""

import json

from jsonschema import Draft202012Validator

from conftest import ROOT


class Schema:
    """A schema file of the repository; each of its definitions describes one kind of value."""

    def __init__(self, path):
        self.path = path
        self.content = json.loads((ROOT / path).read_text())

    def check_itself(self):
        """Checks that the file is a schema, and that each reference leads to a definition."""
        Draft202012Validator.check_schema(self.content, Draft202012Validator.FORMAT_CHECKER)
        assert self.content["$schema"] == Draft202012Validator.META_SCHEMA["$id"]
        known = {f"#/$defs/{name}" for name in self.content["$defs"]}
        unknown = set(references(self.content)) - known
        assert not unknown, f"{self.path}: {unknown}"

    def errors(self, definition, value):
        """The differences between a value and a definition."""
        schema = {"$schema": self.content["$schema"], "$defs": self.content["$defs"], "$ref": f"#/$defs/{definition}"}
        return [f"{error.json_path}: {error.message}" for error in Draft202012Validator(schema).iter_errors(value)]

    def check(self, definition, value):
        """Checks that a value has the form of a definition."""
        errors = self.errors(definition, value)
        assert not errors, f"{definition}: {errors}\n{json.dumps(value, indent=1)}"


def references(schema):
    """All references within a schema."""
    if isinstance(schema, list):
        return [reference for part in schema for reference in references(part)]
    if not isinstance(schema, dict):
        return []
    own = [schema["$ref"]] if isinstance(schema.get("$ref"), str) else []
    return own + references(list(schema.values()))
