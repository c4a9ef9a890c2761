"""The light of a scope: learned where much is seen, and then held."""

import numpy as np

from ursnav_torch.alignment.light import AT_CAMERA, LampState


def test_a_light_is_learned_from_well_aligned_pictures_alone() -> None:
    light, true = LampState(), AT_CAMERA + 0.5
    for bent in range(20):
        light.learn(AT_CAMERA + bent, 0.55)
    assert light.value is None and not light.known
    for nudge in (-0.1, 0.1, 0.0, 3.0, -0.05):
        light.learn(true + nudge, 0.8)
    assert light.known and light.value is not None
    np.testing.assert_allclose(light.value[:-1], true[:-1])  # the median: one that is far off does not count


def test_a_known_light_is_looked_for_again_now_and_then_but_never_where_little_is_seen() -> None:
    light = LampState()
    for _ in range(5):
        light.learn(AT_CAMERA, 0.8)
    for _ in range(50):
        light.learn(AT_CAMERA + 1, 0.5)
    assert light.known
    told = []
    for _ in range(200):
        told.append(light.known)
        light.learn(AT_CAMERA + 1, 0.8)
    assert 0.6 < np.mean(told) < 0.95
    assert light.value is not None
    np.testing.assert_allclose(light.value, AT_CAMERA + 1)  # a changed light is found in the end


def test_the_waters_glow_is_the_last_pictures_and_the_lamp_the_medians() -> None:
    light, murky = LampState(), np.array([0, 0, 0, 0, 0, 0.3])
    light.learn(AT_CAMERA + murky, 0.6)
    assert light.value is None  # no lamp yet
    for _ in range(6):
        light.learn(AT_CAMERA + 1, 0.8)
    light.learn(AT_CAMERA + 2 * murky, 0.6)
    np.testing.assert_allclose(light.value, [*AT_CAMERA[:-1] + 1, 0.6])
    light.learn(AT_CAMERA, 0.4)
    np.testing.assert_allclose(light.value[-1], 0.6)  # too little is shown
