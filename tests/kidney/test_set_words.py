from ursnav_torch.kidney import set_words


def test_sets_are_said_as_people_say_them() -> None:
    assert set_words([]) == "" and set_words(["none"]) == "no calyx" and set_words(["C"]) == "C"
    assert set_words(["C", "D"]) == "C or D" and set_words(["C", "D", "none"]) == "C, D or no calyx"
    assert set_words(["C", "D", "A", "B"]) == "C, D, A or B"
    assert set_words(["C", "D", "A", "B", "none"]) == "C, D or one of 3 others"
