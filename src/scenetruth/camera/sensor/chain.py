"""Sensor as a chain of effects: validation, insertion of effects, image simulation."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError, field_validator
from pydantic_core import InitErrorDetails, PydanticCustomError

from scenetruth.bands import in_band
from scenetruth.camera.sensor.effects import Demosaicing, Effect, Exposure, FilterArray, LinearImage, Unit
from scenetruth.discovery import discriminated_union
from scenetruth.random_streams import GeneratorFor
from scenetruth.validated_model import FrozenModel

__all__ = ["AnyEffect", "InsertedEffect", "OpenSensor", "SensorChain", "check_insertions", "insert_effects"]


if TYPE_CHECKING:
    AnyEffect = Effect
else:
    AnyEffect = discriminated_union(
        Effect, "scenetruth.camera.sensor.effects", "scenetruth.camera.sensor.noise_sources"
    )


class SensorChain(FrozenModel):
    """Ordered list of sensor effects; an empty list is an ideal sensor.

    The input is radiance, and the output unit of each effect must match the input unit of the next. Images are digital
    numbers if the last effect is a digitisation, otherwise floats in the unit of the last effect.
    """

    kind: Literal["chain"] = "chain"
    """Sensor type."""
    effects: tuple[AnyEffect, ...] = ()
    """The effects in signal order."""

    @field_validator("effects")
    @classmethod
    def _fit_together(cls, value: tuple[Effect, ...]) -> tuple[Effect, ...]:
        problems = [*_misfits(value), *_taken_twice(value), *_without_filters(value)] or _blind_spots(value)
        if problems:
            # A validation error raised here preserves the path of each effect.
            raise ValidationError.from_exception_data(cls.__name__, problems)
        return value

    @property
    def unit(self) -> Unit:
        """Unit of the images."""
        return _get_output_unit(self.effects)

    @cached_property
    def full_scale(self) -> float:
        """Largest digital number, or mean response to `saturation_radiance`; 1 for radiance or relative values."""
        scale = _largest_number(self.effects)
        if self.unit == "digital numbers":
            return scale
        signal = self.saturation_radiance
        for effect in self.effects:
            signal = effect.mean_response(signal, scale)
        return signal

    @property
    def dtype(self) -> np.dtype[np.generic]:
        """Data type of the images."""
        if self.unit != "digital numbers":
            return np.dtype(np.float32)
        return np.dtype(np.uint8) if self.full_scale <= np.iinfo(np.uint8).max else np.dtype(np.uint16)

    @property
    def saturation_radiance(self) -> float:
        """Radiance at saturation; 1, the maximum of textures, for an unlimited sensor."""
        limit = _limits(self.effects)[0]
        return limit if np.isfinite(limit) else 1.0

    @property
    def remembers(self) -> bool:
        """Whether an image depends on the previous image."""
        return any(effect.remembers for effect in self.effects)

    @property
    def demosaicing(self) -> str:
        """Method of the demosaicing; empty for none."""
        methods = [effect.method for effect in self.effects if isinstance(effect, Demosaicing)]
        return methods[-1] if methods else ""

    def channels(self, bands: tuple[str, ...]) -> tuple[str, ...]:
        """Return the names of the channels of the images of a camera with these bands; empty for grey images."""
        for effect in self.effects:
            bands = effect.channels(bands)
        return bands

    def band_problems(self, bands: tuple[str, ...]) -> list[str]:
        """Return the problems of the effects with the bands of a camera."""
        problems = []
        for effect in self.effects:
            problems.append(effect.band_problem(bands))
            bands = effect.channels(bands)
        return [problem for problem in problems if problem]

    def open(self, shape: tuple[int, int], generator_for: GeneratorFor, bands: tuple[str, ...] = ()) -> OpenSensor:
        """Return the sensor with the fixed patterns of one recording."""
        return OpenSensor(self, shape, generator_for, bands)


class _Step(NamedTuple):
    """Effect on one band, with its fixed pattern and its random generators by stream."""

    effect: Effect
    pattern: NDArray[np.float64] | None
    generator_for: GeneratorFor
    filter_order: str


class OpenSensor:
    """Sensor chain with the fixed patterns of one recording; with image lag, an image depends on the previous image.

    The bands of a signal have independent random numbers, which are those of a grey camera with ``band`` and the name
    of the band before the key of the stream.
    """

    def __init__(
        self, chain: SensorChain, shape: tuple[int, int], generator_for: GeneratorFor, bands: tuple[str, ...] = ()
    ) -> None:
        self.chain = chain
        self._steps: list[list[_Step]] = []
        for number, effect in enumerate(chain.effects):
            order = _filter_order(chain.effects[:number])
            alone = effect.mixes_bands or not bands
            streams: list[GeneratorFor] = [generator_for]
            if not alone:
                streams = [partial(generator_for, "band", band) for band in bands]
            parts = [effect] if alone else [in_band(effect, band) for band in bands]
            self._steps.append(
                [
                    _Step(part, part.draw_pattern(shape, stream("pattern", part.key)), stream, order)
                    for part, stream in zip(parts, streams, strict=True)
                ]
            )
            bands = effect.channels(bands)
        self._largest_number = _largest_number(chain.effects)

    def read(self, image: LinearImage, previous: LinearImage | None = None) -> NDArray[Any]:
        """Convert a linear image into the sensor output."""
        return self._through(len(self.chain.effects), image, previous).astype(self.chain.dtype)

    def _through(self, count: int, image: LinearImage, previous: LinearImage | None) -> NDArray[np.float64]:
        """Return the signal after the first ``count`` effects."""
        signal = image.radiance.astype(np.float64)
        for number, steps in enumerate(self._steps[:count]):
            # The previous image is processed as a first image, because memory extends to one image only.
            remembers = steps[0].effect.remembers and previous is not None
            before = self._through(number, previous, None) if remembers and previous is not None else None
            if signal.ndim == 2 or steps[0].effect.mixes_bands:
                signal = self._after(steps[0], image, signal, before)
                continue
            bands = [
                self._after(step, image, signal[..., band], None if before is None else before[..., band])
                for band, step in enumerate(steps)
            ]
            signal = np.stack(bands, axis=-1)
        return signal

    def _after(
        self, step: _Step, image: LinearImage, signal: NDArray[np.float64], before: NDArray[np.float64] | None
    ) -> NDArray[np.float64]:
        """Return the signal after one effect."""
        effect = step.effect
        return effect.apply(
            signal,
            Exposure(
                s_y=image.s_y,
                s=image.s,
                t=image.t,
                full_scale=self._largest_number,
                generator=partial(step.generator_for, *effect.stream(image.s_y, image.s, image.t)),
                pattern=step.pattern,
                previous=before,
                filter_order=step.filter_order,
            ),
        )


def _get_output_unit(effects: Sequence[Effect]) -> Unit:
    return effects[-1].gives if effects else "radiance"


def _largest_number(effects: Sequence[Effect]) -> float:
    """Return the largest digital number; 1 without digitisation."""
    converters = [effect for effect in effects if effect.gives == "digital numbers" != effect.takes]
    numbers = [effect.mean_response(np.inf, 1.0) for effect in converters]
    return numbers[-1] if numbers else 1.0


def _limits(effects: Sequence[Effect]) -> list[float]:
    """Return the mean signal levels at saturation before each effect and after the last."""
    scale = _largest_number(effects)
    limits = [1.0 if _get_output_unit(effects) == "share of full scale" else np.inf]
    for effect in reversed(effects):
        limits.append(effect.largest_input(limits[-1], scale))
    return limits[::-1]


def _misfits(effects: Sequence[Effect]) -> list[InitErrorDetails]:
    """Return the effects whose input unit differs from the output unit of the previous effect."""
    problems = []
    given: Unit = "radiance"
    maker = "the chain begins with"
    for index, effect in enumerate(effects):
        if effect.takes != given:
            message = f"'{effect.kind}' takes {effect.takes}, but {maker} {given}"
            problems.append(_chain_problem(index, f"{message}: insert a conversion, or move the effect", effect.kind))
        given, maker = effect.gives, f"'{effect.kind}' before it gives"
    if given == "unrounded digital numbers":
        message = "digital numbers must be rounded: append 'digitisation'"
        problems.append(_chain_problem(len(effects) - 1, message, effects[-1].kind))
    return problems


def _taken_twice(effects: Sequence[Effect]) -> list[InitErrorDetails]:
    """Return the effects that share a random stream with an earlier effect."""
    keys = [effect.key for effect in effects]
    message = "draws the same random numbers as effect {} of the same name: set a unique 'name'"
    return [
        _chain_problem(index, message.format(keys.index(key)), key)
        for index, key in enumerate(keys)
        if keys.index(key) < index
    ]


def _without_filters(effects: Sequence[Effect]) -> list[InitErrorDetails]:
    """Return the demosaicings that no colour filters precede."""
    message = "requires colour filters before it: insert 'colour_filter_array' or 'bayer_filter'"
    return [
        _chain_problem(index, message, effect.kind)
        for index, effect in enumerate(effects)
        if isinstance(effect, Demosaicing) and not _filter_order(effects[:index])
    ]


def _filter_order(effects: Sequence[Effect]) -> str:
    """Return the order of the last colour filters; empty for none."""
    orders = [effect.order for effect in effects if isinstance(effect, FilterArray)]
    return orders[-1] if orders else ""


def _blind_spots(effects: Sequence[Effect]) -> list[InitErrorDetails]:
    """Return the effect that saturates the sensor without light, if any."""
    dark = [index for index, limit in enumerate(_limits(effects)[:-1]) if limit <= 0]
    # The last of these effects causes the saturation of the preceding effects.
    return [_chain_problem(dark[-1], "saturates the sensor without light", effects[dark[-1]].kind)] if dark else []


def _chain_problem(index: int, message: str, given: Any) -> InitErrorDetails:
    return InitErrorDetails(
        type=PydanticCustomError("sensor_chain", "{message}", {"message": message}), loc=(index,), input=given
    )


class InsertedEffect(FrozenModel):
    """Additional effect and its position in the chain."""

    after: str
    """Name of the effect that precedes the insertion; its ``kind`` if unnamed."""
    effect: AnyEffect
    """The effect."""


def insert_effects(effects: Sequence[Effect], insertions: Sequence[InsertedEffect]) -> tuple[Effect, ...]:
    """Insert effects into a chain, one after the other."""
    chain = list(effects)
    for insertion in insertions:
        keys = [effect.key for effect in chain]
        if insertion.after not in keys:
            msg = f"unknown effect '{insertion.after}'; available: {', '.join(keys)}"
            raise ValueError(msg)
        chain.insert(keys.index(insertion.after) + 1, insertion.effect)
    return tuple(chain)


def check_insertions(
    effects: Sequence[Effect], insertions: Sequence[InsertedEffect], field: str
) -> list[InitErrorDetails]:
    """Return all problems of the insertions with their paths."""
    fitting: list[InsertedEffect] = []
    problems = []
    for index, insertion in enumerate(insertions):
        try:
            SensorChain(effects=insert_effects(effects, [*fitting, insertion]))
        except ValidationError as error:
            # An invalid effect may invalidate its successors, so only the first problem is reported.
            cause = error.errors()[0]["msg"]
            problems.append(_insertion_problem((field, index, "effect"), cause, insertion.effect.kind))
        except ValueError as error:
            problems.append(_insertion_problem((field, index, "after"), str(error), insertion.after))
        else:
            fitting.append(insertion)
    return problems


def _insertion_problem(place: tuple[str | int, ...], message: str, given: Any) -> InitErrorDetails:
    return InitErrorDetails(
        type=PydanticCustomError("sensor_insertion", "{message}", {"message": message}), loc=place, input=given
    )
