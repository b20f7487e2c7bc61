"""The scripted controllers by name, and controllers from anywhere as `package.module:Object`."""

from __future__ import annotations

import importlib
import inspect
import sys
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from cdcsr.errors import CdcsrError, unknown_choice
from cdcsr.reading import exists
from cdcsr.robot.description import Robot
from cdcsr.robot.ruler import ruler
from cdcsr.simulation.contract import State
from controllers.controller import Conditions, Controller, Target
from controllers.demonstrations import load
from controllers.jacobian import JacobianController
from controllers.nearest import Nearest

Array = NDArray[np.float64]

SCRIPTED: dict[str, Callable[[Robot], Controller]] = {
    JacobianController.name: JacobianController,
    Nearest.name: Nearest,
}
"""Every scripted controller, by the name that commands know it by."""


def scripted_controller(name: str, robot: Robot) -> Controller | None:
    """Return the controller that a name stands for, or None if it stands for none.

    Args:
        name: a key of :data:`SCRIPTED`; `nearest:FOLDER`, with the folder of a dataset; or
            `package.module:Object`.
        robot: the robot that it is to control.

    Raises:
        CdcsrError: the dataset or the object cannot be loaded.
    """
    if name in SCRIPTED:
        return SCRIPTED[name](robot)
    before, colon, after = name.partition(":")
    if before == Nearest.name and after:
        return Nearest(robot, load(Path(after), robot.fingerprint, ruler(robot).frame_skip))
    if colon and not exists(name):
        return load_controller(name, robot)
    return None


@runtime_checkable
class _Acting(Protocol):
    """An object that acts as a controller does."""

    def act(self, state: State, target: Target, time: Array, /) -> Array: ...


class LoadedController(Controller):
    """A controller that somebody else wrote; its mistakes become errors of one line.

    Args:
        acting: an object with the method `act` of a :class:`Controller`. Its other attributes are
            used where it has them.
        name: the name in tables, if it has none of its own.
    """

    def __init__(self, acting: _Acting, name: str) -> None:
        self._acting = acting
        self.name = str(getattr(acting, "name", name))
        self.privileged = bool(getattr(acting, "privileged", False))
        own = getattr(acting, "frame_skip", None)
        self.frame_skip = None if own is None else int(own)
        self.task = str(getattr(acting, "task", "reach"))

    @property
    def centers(self) -> Array | None:
        return getattr(self._acting, "centers", None)

    def begin(self, conditions: Conditions) -> None:
        """Call the object's own `begin`, if it has one.

        Raises:
            CdcsrError: it failed.
        """
        self._shape = conditions.robot.num_cables
        begin = getattr(self._acting, "begin", None)
        if begin is not None:
            _call(f"{self.name}.begin", begin, conditions)

    def act(self, state: State, target: Target, time: Array) -> Array:
        """Return the object's commands, zero for copies whose episode is over.

        Raises:
            CdcsrError: it failed, or its commands have the wrong shape or are not finite.
        """
        found = _call(f"{self.name}.act", self._acting.act, state, target, time)
        expected, over = (len(time), self._shape), np.isnan(time)
        try:
            commands = np.asarray(found, dtype=np.float64)
        except (TypeError, ValueError):
            raise CdcsrError(
                f"{self.name}.act returned {type(found).__name__}, not an array of commands of "
                f"shape (num, cables) = {expected}."
            ) from None
        if commands.shape != expected:
            raise CdcsrError(
                f"{self.name}.act returned commands of shape {commands.shape}; it must be "
                f"(num, cables) = {expected}."
            )
        if not np.isfinite(commands[~over]).all():
            raise CdcsrError(
                f"{self.name}.act returned a command that is not finite, {np.nanmin(time):g} s "
                "after the start."
            )
        return np.where(over[:, None], 0.0, commands)


def load_controller(path: str, robot: Robot) -> Controller:
    """Load a controller from `package.module:Object`.

    The module is looked for where Python looks for modules, the working folder included.

    Args:
        path: the object is a controller, or a class or function that makes one, from no argument or
            from the robot. Any object with the method `act` of a :class:`Controller` is one.
        robot: the robot that it is to control.

    Raises:
        CdcsrError: there is no such object, or it is and makes no controller.
    """
    module_name, _, attribute = path.partition(":")
    if not module_name or not attribute:
        raise CdcsrError(f"Write a controller as package.module:Object, not {path!r}.")
    folder = str(Path.cwd())
    if folder not in sys.path:
        sys.path.insert(0, folder)
    found: object = _call(f"Importing {module_name}", importlib.import_module, module_name)
    if not hasattr(found, attribute):
        public = [name for name in vars(found) if not name.startswith("_")]
        raise CdcsrError(unknown_choice(f"name in {module_name}", attribute, public))
    made: object = getattr(found, attribute)
    if inspect.isclass(made) or not hasattr(made, "act"):
        made = _make(path, made, robot)
    if not isinstance(made, _Acting) or not _takes(made.act, 3):
        raise CdcsrError(
            f"{path} is no controller: {type(made).__name__} has no method "
            "act(state, target, time)."
        )
    return LoadedController(made, attribute)


def _make(path: str, factory: object, robot: Robot) -> object:
    """Call a factory with the robot if it needs an argument, else without."""
    if not callable(factory):
        raise CdcsrError(
            f"{path} is no controller: {type(factory).__name__} has no method "
            "act(state, target, time)."
        )
    for arguments in ((), (robot,)):
        if _takes(factory, len(arguments)):
            return _call(f"Making {path}", factory, *arguments)
    raise CdcsrError(f"{path} must make a controller from no argument or from the robot.")


def _takes(function: Callable[..., object], arguments: int) -> bool:
    """Tell whether a function can be called with so many positional arguments."""
    try:
        inspect.signature(function).bind(*range(arguments))
    except (TypeError, ValueError):
        return False
    return True


def _call(what: str, function: Callable[..., object], *arguments: object) -> object:
    """Call somebody else's function; its exception becomes one line that says where it arose."""
    try:
        return function(*arguments)
    except CdcsrError:
        raise
    except Exception as error:
        frame = traceback.extract_tb(error.__traceback__)[-1]
        place = "" if "importlib" in frame.filename else f" ({frame.filename}, line {frame.lineno})"
        reason = (str(error).splitlines() or [""])[0]
        raise CdcsrError(f"{what} failed: {type(error).__name__}: {reason}{place}.") from error
