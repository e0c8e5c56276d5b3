"""Writes the docstrings of the compiled module into its stub, where editors read them: cargo xtask python --stub."""

import ast
import inspect
import textwrap
from pathlib import Path

import pb3dp

STUB = Path(__file__).resolve().parents[2] / "crates/python/python/pb3dp/_pb3dp.pyi"


def documented(body, owner):
    """The classes and functions of a stub, with what they describe."""
    for node in body:
        if isinstance(node, ast.ClassDef | ast.FunctionDef) and not node.name.startswith("_"):
            thing = getattr(owner, node.name)
            yield node, thing
            if isinstance(node, ast.ClassDef):
                yield from documented(node.body, thing)


def with_docstrings(stub):
    """The stub with the docstrings of the module in the place of its own."""
    lines = stub.splitlines()
    # From the end, as line numbers change.
    for node, thing in reversed(list(documented(ast.parse(stub).body, pb3dp._pb3dp))):
        text = inspect.getdoc(thing)
        text = f'"""{text}\n"""' if "\n" in text else f'"""{text}"""'
        text = textwrap.indent(text, " " * (node.col_offset + 4)).splitlines()
        first = node.body[0]
        begin = min([first.lineno, *(decorator.lineno for decorator in getattr(first, "decorator_list", []))]) - 1
        is_kept = not (isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant))
        header = [] if is_kept else [lines[begin][: first.col_offset].rstrip()]
        lines[begin : begin if is_kept else first.end_lineno] = [*filter(None, header), *text]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    STUB.write_text(with_docstrings(STUB.read_text()))
