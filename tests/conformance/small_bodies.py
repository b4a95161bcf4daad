"""Two small bodies of another make: a crane that has all that a body may have, and a machine."""

from collections.abc import Mapping
from typing import Any

import msgspec
import numpy as np

from mdb_sim.body import NOTHING, Actuator, BodyError, Numbers, Outcome, Reading, Resting, Sensor, Spec, Unrestorable

STEPS = (-1.0, 0.0, 1.0)
END_M = 3.0


class _Used:
    """What may be asked of a body before its first episode, and when it is closed."""

    def __init__(self) -> None:
        self._begun = self._closed = False

    def _open(self, *, begun: bool = True) -> None:
        if self._closed:
            raise BodyError("it is closed; make another one")
        if begun and not self._begun:
            raise BodyError("it stands nowhere yet; call reset(seed, 0) first")

    def close(self) -> None:
        self._closed = True


class Crane(_Used, Resting):
    """Moves along a rail and lifts, one step or none each: a vector, a sensor that is silent, choices, an image.

    It always begins in the middle, and can do nothing more when it has come to an end of its rail.
    """

    def __init__(self, load_kg: float = 1.0) -> None:
        super().__init__()
        self._load_kg, self._place = load_kg, (0.0, 0.0)

    @property
    def spec(self) -> Spec:
        return Spec(
            sensors=(
                Sensor(name="rows", low=0.0, high=1.0, numbers=3),
                Sensor(name="load", low=0.0, high=10.0, unit="kg"),
            ),
            actuators=(Actuator(name="along", low=-1.0, high=1.0), Actuator(name="up", low=-1.0, high=1.0)),
            choices=tuple({"along": along, "up": up} for along in STEPS for up in STEPS),
            events=("end",),
            final=("end",),
            scene=("x_m", "height_m"),
            changes=("load_kg",),
        )

    def reset(self, seed: int, episode: int) -> Reading:
        del seed, episode
        self._open(begun=False)
        self._begun, self._place = True, (0.0, 0.0)
        return self._reading()

    def act(self, values: Mapping[str, float]) -> Outcome:
        self._open()
        if dict(values) not in self.spec.choices:
            raise BodyError(f"action {dict(values)}; expected one of its {len(self.spec.choices)} choices")
        if abs(self._place[0]) >= END_M:
            raise BodyError("it is at the end of its rail; call reset(seed, episode) for the next episode")
        along, up = (at + values[name] for at, name in zip(self._place, ("along", "up"), strict=True))
        at_end = abs(along) >= END_M
        self._place = min(END_M, max(-END_M, along)), max(0.0, up)
        return Outcome("end" if at_end else NOTHING, self._reading())

    def _reading(self) -> Reading:
        along, height = self._place
        rows = [1.0 if along < 0.0 else 0.0, 1.0 if along == 0.0 else 0.0, 1.0 if along > 0.0 else 0.0]
        return {"rows": rows} | ({"load": self._load_kg} if height > 0.0 else {})

    def scene(self) -> Numbers:
        self._open()
        return dict(zip(self.spec.scene, self._place, strict=True))

    def state(self) -> bytes | None:
        self._open()
        return msgspec.json.encode((self._place, self._load_kg))

    def restore(self, state: bytes) -> None:
        self._open(begun=False)
        try:
            place, load_kg = msgspec.json.decode(state, type=tuple[tuple[float, float], float])
        except (msgspec.ValidationError, msgspec.DecodeError) as error:
            raise BodyError(f"no state of a crane: {error}") from error
        self._begun, self._place, self._load_kg = True, place, load_kg

    def change(self, **settings: Any) -> None:
        if settings.keys() != {"load_kg"} or not 0.0 < settings["load_kg"] <= 10.0:
            raise BodyError(f"settings {settings}; expected load_kg above 0 and up to 10 alone")
        self._load_kg = float(settings["load_kg"])

    def image(self) -> np.ndarray:
        image = np.zeros((8, 16, 3), np.uint8)
        image[0, round(8 + self._place[0])] = 255
        return image


class Turntable(_Used, Unrestorable):
    """A machine: it goes on where it stands, and what it does errs a little. It is told any value in a range."""

    spec = Spec(
        sensors=(Sensor(name="angle", low=-180.0, high=180.0, unit="deg"),),
        actuators=(Actuator(name="spin", low=-90.0, high=90.0, unit="deg"),),
        scene=("angle_deg",),
    )

    def __init__(self) -> None:
        super().__init__()
        self._rng, self._angle_deg, self._halts = np.random.default_rng(), 0.0, 0

    def reset(self, seed: int, episode: int) -> Reading:
        del seed, episode
        self._open(begun=False)
        self._begun = True
        return {"angle": self._angle_deg}

    def act(self, values: Mapping[str, float]) -> Outcome:
        self._open()
        spin_deg = values.get("spin", float("nan"))
        if values.keys() != {"spin"} or not -90.0 <= spin_deg <= 90.0:
            raise BodyError(f"action {dict(values)}; expected spin = -90 to 90 alone")
        turned_deg = self._angle_deg + spin_deg + float(self._rng.normal())
        self._angle_deg = (turned_deg + 180.0) % 360.0 - 180.0
        return Outcome(NOTHING, {"angle": self._angle_deg})

    def halt(self) -> None:
        self._halts += 1

    def scene(self) -> Numbers:
        self._open()
        return {"angle_deg": self._angle_deg}
