"""The values of constant expressions in a syntax tree."""

from __future__ import annotations

import ast
from collections.abc import Iterator, Mapping


def assigned_texts(tree: ast.Module) -> dict[str, str]:
    """Return name -> text for the names that the module sets once to a constant text."""
    found: dict[str, str] = {}
    for node in tree.body:
        if isinstance(node, ast.Assign) and len(node.targets) == 1:
            target, value = node.targets[0], text_of(node.value, found)
            if isinstance(target, ast.Name) and value is not None:
                found[target.id] = value
    return found


def text_of(node: ast.expr | None, names: Mapping[str, str]) -> str | None:
    """Return the text that an expression has, None where that cannot be told.

    It may be a constant, a name of `names`, a sum, an f-string, or a call of os.path.join.
    """
    try:
        return _text_of(node, names)
    except RecursionError:  # not written by hand
        return None


def _text_of(node: ast.expr | None, names: Mapping[str, str]) -> str | None:
    match node:
        case ast.Constant(value=str() as text):
            return text
        case ast.Name(id=name):
            return names.get(name)
        case ast.BinOp(left=left, op=ast.Add(), right=right):
            return _joined("", [left, right], names)
        case ast.JoinedStr(values=values):
            return _joined("", values, names)
        case ast.FormattedValue(value=value):
            return _text_of(value, names)
        case ast.Call(func=ast.Attribute(attr="join"), args=parts, keywords=[]):
            return _joined("/", parts, names)
    return None


def texts_within(node: ast.AST, names: Mapping[str, str]) -> Iterator[str]:
    """Yield the value of each expression in this tree that is known to be a string."""
    for each in ast.walk(node):
        if isinstance(each, ast.expr) and (text := text_of(each, names)) is not None:
            yield text


def keyword(call: ast.Call, name: str) -> ast.expr | None:
    """Return the argument of a call that is given by this name."""
    return next((each.value for each in call.keywords if each.arg == name), None)


def called(node: ast.Call) -> str:
    """Return the last part of the name of what is called, such as `spin` of `rclpy.spin`."""
    match node.func:
        case ast.Attribute(attr=name) | ast.Name(id=name):
            return name
    return ""


def calls(tree: ast.AST) -> Iterator[ast.Call]:
    """Yield every call in the tree."""
    return (node for node in ast.walk(tree) if isinstance(node, ast.Call))


def _joined(separator: str, parts: list[ast.expr], names: Mapping[str, str]) -> str | None:
    texts = [_text_of(part, names) for part in parts]
    return None if None in texts else separator.join(each for each in texts if each is not None)
