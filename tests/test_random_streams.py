from __future__ import annotations

from scenetruth.random_streams import generator_for


def test_generators_are_keyed_by_purpose_not_by_order() -> None:
    first = generator_for(1, "sensor", 0, 0).random(4)
    generator_for(1, "sensor", 1, 0).random(4)
    assert (generator_for(1, "sensor", 0, 0).random(4) == first).all()
    for other in (
        generator_for(2, "sensor", 0, 0),
        generator_for(1, "sensor", 0, 1),
        generator_for(1, "texture", "0/0"),
    ):
        assert (other.random(4) != first).all()
