"""Matrix of a `<transform>` of a Mitsuba XML, by Mitsuba's rules: each step is applied after the ones before it."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ElementTree

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from xfreqbench.errors import SceneError
from xfreqbench.types import FloatArray

FLAT = 1e-12  # a matrix is singular where its determinant is this share of its columns' lengths


def affine_transform(transform: ElementTree.Element, where: str) -> Float[FloatArray, "4 4"]:
    """Matrix of a `<transform>` with steps translate, rotate, scale, matrix and lookat, the first applied first.

    `where` begins the message of the `SceneError` for a step that is unknown, has no sound numbers, or is not affine,
    and for steps that leave nothing of a shape.
    """
    steps = {
        "translate": _translate,
        "rotate": _rotate,
        "scale": _scale,
        "matrix": _matrix,
        "lookat": _look_at,
        "lookAt": _look_at,
    }
    whole = np.eye(4)
    for element in transform:
        if element.tag not in steps:
            raise SceneError(
                f"{where} has a <transform> with the step {element.tag!r}; use translate, rotate, scale, matrix "
                "or lookat."
            )
        with np.errstate(all="ignore"):  # of numbers that no float holds, which are refused below
            whole = steps[element.tag](element, where) @ whole
    if not np.isfinite(whole).all():
        raise SceneError(f"{where} has a <transform> that moves it beyond every number.")
    lengths = np.linalg.norm(whole[:3, :3], axis=0)
    if not abs(np.linalg.det(whole[:3, :3])) > FLAT * np.prod(lengths):
        raise SceneError(f"{where} has a <transform> that flattens it; no scale may be 0.")
    return whole


def vector(element: ElementTree.Element, where: str, default: float = 0.0) -> Float[FloatArray, "3"]:
    """The three numbers of an element: from `x`, `y` and `z`, each with a default, or from one or three in `value`."""
    if "value" not in element.attrib:
        return np.array([_numbers(element.get(axis, str(default)), element, where, 1)[0] for axis in "xyz"])
    return _numbers(element.get("value", ""), element, where, 1, 3) * np.ones(3)


def _numbers(text: str, element: ElementTree.Element, where: str, *counts: int) -> Float[FloatArray, "n"]:
    """Numbers of a text, separated by blanks or commas."""
    try:
        numbers = np.array([float(word) for word in text.replace(",", " ").split()])
    except ValueError:
        numbers = np.array([math.nan])
    if len(numbers) not in counts or not np.isfinite(numbers).all():
        raise SceneError(
            f"{where} has a <{element.tag}> with {text[:60]!r}; give {' or '.join(map(str, counts))} finite numbers."
        )
    return numbers


def _translate(element: ElementTree.Element, where: str) -> Float[FloatArray, "4 4"]:
    matrix = np.eye(4)
    matrix[:3, 3] = vector(element, where)
    return matrix


def _rotate(element: ElementTree.Element, where: str) -> Float[FloatArray, "4 4"]:
    axis = vector(element, where)
    angle_deg = _numbers(element.get("angle", ""), element, where, 1)[0]
    matrix = np.eye(4)
    turn = Rotation.from_rotvec(np.radians(angle_deg) * _direction(axis, "axis", where))
    matrix[:3, :3] = turn.as_matrix()
    return matrix


def _scale(element: ElementTree.Element, where: str) -> Float[FloatArray, "4 4"]:
    return np.diag([*vector(element, where, default=1.0), 1.0])


def _matrix(element: ElementTree.Element, where: str) -> Float[FloatArray, "4 4"]:
    values = _numbers(element.get("value", ""), element, where, 9, 16)
    matrix = np.eye(4)
    if len(values) == 9:
        matrix[:3, :3] = values.reshape(3, 3)
        return matrix
    matrix = values.reshape(4, 4)
    if matrix[3].tolist() != [0, 0, 0, 1]:
        raise SceneError(
            f"{where} has a <matrix> whose last row is {matrix[3].tolist()}; it must be 0 0 0 1."
        )
    return matrix


def _look_at(element: ElementTree.Element, where: str) -> Float[FloatArray, "4 4"]:
    """The frame at `origin` whose z looks to `target`, and whose y leans towards `up`."""
    origin, target, up = (
        _numbers(element.get(key, ""), element, where, 3) for key in ("origin", "target", "up")
    )
    forward = _direction(target - origin, "way to its target", where)
    left = _direction(np.cross(up, forward), "turn about its way to the target", where)
    matrix = np.eye(4)
    matrix[:3] = np.stack([left, np.cross(forward, left), forward, origin], axis=1)
    return matrix


def _direction(vector: Float[FloatArray, "3"], what: str, where: str) -> Float[FloatArray, "3"]:
    length = np.linalg.norm(vector)
    if not length > 0:
        raise SceneError(
            f"{where} has a <transform> whose {what} has no direction; give one that is not zero."
        )
    return vector / length
