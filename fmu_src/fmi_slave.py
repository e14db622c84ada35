"""The FMI 2.0 slave of our FMUs: it maps FMI names to a model, and lets no exception out.

An exception that leaves a slave ends in fmi2Fatal, and hosts crash on it. So every error becomes a
log line, and the next fmi2DoStep a fmi2Discard with the state unchanged:
- a *refusal* (a parameter set too late, a value of an unknown variable) fails one step;
- a *fault* (a bad start value, a bad saved state) fails every step until a reset or a good state.
"""

from __future__ import annotations

import contextlib
import json
import sys
from collections.abc import Sequence
from hashlib import sha256
from math import inf, isfinite, nan
from operator import itemgetter
from typing import Any, Protocol

from pythonfmu import Fmi2Slave
from pythonfmu.enums import Fmi2Status

from chaincrane import clock
from chaincrane.build_info import SOURCES
from chaincrane.errors import BadState, BadValue, CraneError
from chaincrane.variables import FINITE, Variable
from chaincrane.whole_step import check_finite

STATE_MAGIC = b"chaincrane state 1\n"
MOST_PICKS = 64  # sets of outputs asked for together that an instance keeps in mind


class Model(Protocol):
    """What a slave runs."""

    start_time: float  # s, the host's; only for messages

    def advance(self, h: float, told: Any) -> Sequence[Any]:
        """Advance by ``h`` s under the slave's ``inputs``; the outputs then, all finite.

        They may be a view, of what is now at any time. Raises CraneError, the model as it was,
        where that cannot be had.
        """

    def notice(self) -> str | None:
        """What a user should be told of the model's state, once; None: nothing."""

    def output_values(self) -> list[Any]:
        """Outputs in the interface's order."""

    def save(self) -> bytes:
        """The whole state, bit for bit."""

    def load(self, state: bytes) -> None:
        """Restore what :meth:`save` gave."""


class FmiSlave(Fmi2Slave):  # type: ignore[misc]  # pythonfmu has no types
    """Base of our slaves; a subclass says which interface it has and which model it runs.

    A variable's value reference is its place in ``variables``: inputs, parameters, then outputs.
    """

    variables: tuple[Variable, ...]
    inputs: type  # a dataclass with a field for each input, the name of which is the row's symbol
    step_unit: str | None = None  # parameter, s: a step that is a whole number of it is meant so

    def make_model(self, parameters: dict[str, Any]) -> Model:
        """The model for parameter values by name; raises CraneError for what is not allowed."""
        raise NotImplementedError

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        self.modelName = type(self).__name__
        places = list(enumerate(self.variables))
        self._inputs, self._parameters, outputs = (
            [place for place, variable in places if variable.causality == causality]
            for causality in ("input", "parameter", "output")
        )
        self._first_output = outputs[0]
        self._symbols = [self.variables[place].symbol for place in self._inputs]
        self._of_kind = {
            kind: frozenset(place for place, variable in places if variable.kind == kind)
            for kind in ("Real", "Integer", "String", "Boolean")
        }
        self._real_inputs = self._of_kind["Real"].intersection(self._inputs)
        self._real_outputs = self._of_kind["Real"].intersection(outputs)
        self._no_outputs = [
            nan if variable.kind == "Real" else 0
            for variable in self.variables[self._first_output :]
        ]
        self._values = [variable.start for variable in self.variables[: self._first_output]]
        self._seen: Sequence[Any] = self._no_outputs  # the outputs, if they are observed
        self._picks: dict[tuple[int, ...], itemgetter[Any]] = {}  # outputs asked for together
        units = [place for place, variable in places if variable.name == self.step_unit]
        self._step_unit = units[0] if units else None
        self._command: Any = None  # the inputs as the model takes them; None: they were set anew
        self._model: Model | None = None
        self._observed = False
        self._phase = "instantiated"
        self._start = self._time = 0.0
        self._stop = inf  # s, beyond which no step may go
        self.tolerance: float | None = None  # of the host's experiment; None: it has none
        self._fault: str | None = None
        self._refusal: str | None = None
        self._last_error: str | None = None
        self._noticed = False

    # --- FMI life cycle -----------------------------------------------------------------------

    def setup_experiment(
        self, start_time: float, stop_time: float | None = None, tolerance: float | None = None
    ) -> None:
        """Keep start time, stop time and tolerance."""
        if self._phase != "instantiated":
            self._refuse("an experiment can be set up only before initialisation mode")
        elif not isfinite(start_time):
            self._refuse(str(BadValue("start time", start_time, "a finite number, s")))
        elif stop_time is not None and not (isfinite(stop_time) and stop_time >= start_time):
            allowed = "a finite number, s, not before the start time"
            self._refuse(str(BadValue("stop time", stop_time, allowed)))
        else:
            self._start = self._time = start_time
            self._stop = inf if stop_time is None else stop_time
            self.tolerance = tolerance
            self._model, self._observed = None, False

    def enter_initialization_mode(self) -> None:
        """From here on, until it is left, start values may be set and outputs be read."""
        if self._phase == "instantiated":
            self._phase = "initialising"
        else:
            self._refuse("initialisation mode can be entered once, before the first step")

    def exit_initialization_mode(self) -> None:
        """Build the model from the start values; a bad one fails every step that follows."""
        if self._phase != "initialising":
            self._refuse("initialisation mode was left without being entered")
            return
        self._phase = "stepping"
        if self._model is None:  # else it was made to be looked at, from the same values
            self._build()
        else:
            self._model.start_time = self._start
        self._say_notice()

    def do_step(self, current_time: float, step_size: float) -> bool:
        """Advance the model; False, the state unchanged, where that cannot be done."""
        try:
            self._step(current_time, step_size)
        except CraneError as error:
            self._log_error(str(error))
            return False
        except Exception as error:  # a defect of ours must not take the host down
            self._log_error(f"internal error, please report it: {error!r}")
            return False
        return True

    def terminate(self) -> None:
        """Nothing to release; a step after this is refused."""
        if self._phase == "stepping":
            self._phase = "terminated"
        else:
            self._refuse(
                f"only an initialised instance can be terminated; this one is {self._phase}"
            )

    def _step(self, current_time: float, step_size: float) -> None:
        if self._fault is not None:
            raise CraneError(self._fault)
        if self._refusal is not None:
            refusal, self._refusal = self._refusal, None
            raise CraneError(refusal)
        if self._phase != "stepping" or self._model is None:
            raise CraneError(f"a step needs an initialised instance; this one is {self._phase}")
        if current_time != self._time and not clock.is_now(current_time, self._time, step_size):
            allowed = f"the time reached, {self._time!r} s"
            raise BadValue("current communication point", current_time, allowed)
        end = current_time + step_size
        if end > self._stop and clock.is_beyond(end, self._stop, step_size):
            raise BadValue("end of the step", end, f"at most the stop time, {self._stop!r} s")
        if self._command is None:
            told = self._values[: len(self._inputs)]
            self._command = self.inputs(**dict(zip(self._symbols, told, strict=True)))
        meant = step_size  # without the round-off of the host's times
        if self._step_unit is not None:
            unit: Any = self._values[self._step_unit]
            meant = clock.meant_step(current_time, step_size, unit)
        self._seen = self._model.advance(meant, self._command)
        self._observed = True
        self._time = end
        self._say_notice()

    def _look(self, model: Model, allowed: str) -> None:
        """Read the model's outputs; BadValue where one is not a finite number."""
        seen = model.output_values()
        names = [variable.name for variable in self.variables[self._first_output :]]
        check_finite(dict(zip(names, seen, strict=True)), allowed)
        self._seen, self._observed = seen, True

    def _say_notice(self) -> None:
        """Log what a user should be told of the model, once."""
        notice = None if self._model is None else self._model.notice()
        if notice is not None and not self._noticed:
            started = self._time > self._start
            when = f"at t = {self._time:.6g} s" if started else "at initialisation"
            self.log(f"{when}: {notice}", Fmi2Status.warning, "logStatusWarning")
            self._noticed = True

    def _build(self) -> None:
        """Make the model from the parameters; a bad one becomes a fault."""
        values = {self.variables[place].name: self._values[place] for place in self._parameters}
        self._observed = False
        try:
            self._model = self.make_model(values)
            self._model.start_time = self._start
            self._look(self._model, "parameters that keep it finite")
        except Exception as error:
            self._model = None
            self._fail(error)

    # --- variables ----------------------------------------------------------------------------

    def get_real(self, vrs: list[int]) -> list[float]:
        """Values of Real variables by value reference."""
        if self._observed:
            pick = self._picks.get(tuple(vrs))  # at every step the same
            if pick is not None:
                return list(pick(self._seen))
        return self._get("Real", vrs, nan)

    def get_integer(self, vrs: list[int]) -> list[int]:
        """Values of Integer variables by value reference."""
        return self._get("Integer", vrs, 0)

    def get_string(self, vrs: list[int]) -> list[str]:
        """Values of String variables by value reference."""
        return self._get("String", vrs, "")

    def get_boolean(self, vrs: list[int]) -> list[bool]:
        """There are no Boolean variables."""
        return self._get("Boolean", vrs, False)

    def set_real(self, vrs: list[int], values: list[float]) -> None:
        """Set Real inputs and parameters by value reference."""
        self._set("Real", vrs, values)

    def set_integer(self, vrs: list[int], values: list[int]) -> None:
        """Set Integer parameters by value reference."""
        self._set("Integer", vrs, values)

    def set_string(self, vrs: list[int], values: list[str]) -> None:
        """Set String parameters by value reference."""
        self._set("String", vrs, values)

    def set_boolean(self, vrs: list[int], values: list[bool]) -> None:
        """There are no Boolean variables."""
        self._set("Boolean", vrs, values)

    def _get(self, kind: str, vrs: list[int], missing: Any) -> list[Any]:
        if not self._of_kind[kind].issuperset(vrs):
            strange = next(vr for vr in vrs if vr not in self._of_kind[kind])
            self._refuse(f"no {kind} variable has the value reference {strange}")
            return [missing] * len(vrs)
        if not self._observed:
            self._observe()
        values, seen, first = self._values, self._seen, self._first_output
        found = [values[vr] if vr < first else seen[vr - first] for vr in vrs]
        if vrs and self._real_outputs.issuperset(vrs) and len(self._picks) < MOST_PICKS:
            at = [vr - first for vr in vrs]  # of one place itemgetter would give no sequence
            one = slice(at[0], at[0] + 1)
            self._picks[tuple(vrs)] = itemgetter(*at) if len(at) > 1 else itemgetter(one)
        return found

    def _set(self, kind: str, vrs: list[int], values: list[Any]) -> None:
        if kind == "Real" and self._real_inputs.issuperset(vrs):  # at every step
            for vr, value in zip(vrs, values, strict=False):
                self._values[vr] = value
            self._command = None
            return
        for vr, value in zip(vrs, values, strict=False):
            if vr not in self._of_kind[kind]:
                self._refuse(f"no {kind} variable has the value reference {vr}")
                continue
            variable = self.variables[vr]
            if variable.causality == "output":
                self._refuse(f"{variable.name} is an output: it cannot be set")
            elif variable.causality == "input":
                self._values[vr] = value
                self._command = None
            elif self._phase in ("stepping", "terminated"):
                self._refuse(
                    f"{variable.name} is a parameter: it is fixed when initialisation ends,"
                    f" and cannot be set to {value!r} now"
                )
            else:
                self._values[vr] = value
                self._model, self._observed = None, False

    def _observe(self) -> None:
        """Read the model's outputs; without a model they are not a number, and no zeros."""
        if self._model is None and self._fault is None:
            self._build()
            if self._phase != "stepping":
                self._fault = None  # start values may still be mended
        elif self._model is not None:
            try:
                self._look(self._model, FINITE)
            except Exception as error:
                self._fail(error)
        if not self._observed:
            self._seen, self._observed = self._no_outputs, True

    # --- errors -------------------------------------------------------------------------------

    def _refuse(self, message: str) -> None:
        """Log what is refused now; the next step fails with it, once."""
        self._log_error(message)
        self._refusal = message

    def _fail(self, error: Exception) -> None:
        """Log an error that every step from now on fails with, until a reset or a good state."""
        known = isinstance(error, CraneError)
        self._fault = str(error) if known else f"internal error, please report it: {error!r}"
        self._log_error(self._fault)

    def log(
        self,
        msg: str,
        status: Fmi2Status = Fmi2Status.ok,
        category: str | None = None,
        debug: bool | None = None,
    ) -> None:
        """Log a message. FMI's loggers take a format, in which % is %%: pythonfmu hands on ours."""
        super().log(msg.replace("%", "%%"), status, category, debug)

    def _log_error(self, message: str) -> None:
        """One line in the FMI log; on stderr too, since pythonfmu drops it where logging is off."""
        self.log(message, Fmi2Status.error, "logStatusError")
        if message != self._last_error:
            with contextlib.suppress(OSError, ValueError):  # a host may have closed stderr
                print(f"{self.instance_name} ({self.modelName}): {message}", file=sys.stderr)
        self._last_error = message

    # --- state --------------------------------------------------------------------------------

    def _get_fmu_state(self) -> bytes:
        """The whole state of the instance as bytes, with the build that it belongs to."""
        head = {
            "model": self.modelName,
            "sources": SOURCES,
            "phase": self._phase,
            "start": self._start,
            "time": self._time,
            "tolerance": self.tolerance,
            "fault": self._fault,
            "refusal": self._refusal,
            "values": self._values,
        }
        try:
            model = b"" if self._model is None else self._model.save()
            body = json.dumps(head).encode() + b"\n" + model
        except Exception as error:
            self._fail(error)
            return b""  # no state: restoring it is refused
        return STATE_MAGIC + sha256(body).digest() + body

    def _set_fmu_state(self, state: bytes) -> None:
        """Restore a state, all or nothing; one that is damaged or foreign becomes a fault."""
        kept = {**self.__dict__, "_values": list(self._values)}
        try:
            self._restore(state)
        except Exception as error:
            self.__dict__.update(kept)
            known = isinstance(error, CraneError)
            self._fail(error if known else BadState(f"the saved state cannot be read: {error!r}"))

    def _restore(self, state: bytes) -> None:
        digest_end = len(STATE_MAGIC) + 32
        body = state[digest_end:]
        if state[:digest_end] != STATE_MAGIC + sha256(body).digest():
            raise BadState("the saved state is damaged, or not a chaincrane state")
        line, model_bytes = body.split(b"\n", 1)
        head = json.loads(line)
        if (head["model"], head["sources"]) != (self.modelName, SOURCES):
            raise BadState(
                f"the saved state is of {head['model']}, sources {head['sources']};"
                f" this is {self.modelName}, sources {SOURCES}"
            )
        first_parameter = len(self._inputs)
        parameters = self._values[first_parameter:]
        same = (parameters, self.tolerance) == (
            head["values"][first_parameter:],
            head["tolerance"],
        )
        self._values[:] = head["values"]
        self._phase, self._start, self._time = head["phase"], head["start"], head["time"]
        self.tolerance = head["tolerance"]
        self._command = None
        self._observed, self._refusal, self._fault = False, head["refusal"], None
        if not (same and model_bytes):  # a model of other parameters is of no use
            self._model = None
        if model_bytes:
            if self._model is None:
                self._build()
            if self._model is None:
                raise CraneError(self._fault)
            self._model.load(model_bytes)
            self._noticed = self._model.notice() is not None
            self._model.start_time = self._start
        self._fault = head["fault"]

    @staticmethod
    def _fmu_state_to_bytes(state: bytes) -> bytes:
        return state

    @staticmethod
    def _fmu_state_from_bytes(state: bytes) -> bytes:
        return bytes(state)
