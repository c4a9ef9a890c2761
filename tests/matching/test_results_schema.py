import copy
import json
from pathlib import Path

import pytest

from benchmarks.shared.results import FOLDER, Report, describe_run, overrides, time_interleaved, validate
from ursnav_torch.errors import InputError


def content() -> dict:
    report = Report("suite", {"views": 40})
    report.add("group", "row", "ms", [3.0, 1.0, 2.0, 5.0, 4.0])
    report.skip("rival", "not installed")
    return describe_run(report)


@pytest.mark.parametrize("path", sorted(FOLDER.glob("*.json")), ids=lambda path: path.stem)
def test_committed_results_follow_the_schema(path: Path) -> None:
    validate(json.loads(path.read_text(encoding="utf-8")))


def test_a_report_follows_the_schema_and_holds_median_and_quartiles(tmp_path: Path) -> None:
    made = content()
    validate(made)
    row = made["rows"][0]
    assert (row["median"], row["quartiles"], row["n"]) == (3.0, (2.0, 4.0), 5)
    assert made["skipped"] == [{"name": "rival", "reason": "not installed"}]
    report = Report("suite", {})
    report.add("group", "row", "%", [50.0], n=60)
    written = report.write(tmp_path / "a" / "b.json")
    validate(json.loads(written.read_text(encoding="utf-8")))
    assert "| row | 50 % | 50 to 50 | 60 |  |" in report.table()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda c: c.pop("threads"), "differ from the schema"),
        (lambda c: c.update(more=1), "differ from the schema"),
        (lambda c: c.update(threads="2"), "threads is a str"),
        (lambda c: c.update(rows=[]), "at least one row"),
        (lambda c: c.update(commit="main"), "commit is 'main'"),
        (lambda c: c["machine"].pop("cores"), "machine"),
        (lambda c: c["rows"][0].update(quartiles=(4.0, 2.0)), "out of order"),
        (lambda c: c["rows"][0].update(median=float("nan")), "not a finite number"),
        (lambda c: c["rows"][0].pop("note"), "other fields"),
    ],
)
def test_refuses_what_does_not_follow_it(change, message: str) -> None:  # type: ignore[no-untyped-def]
    broken = copy.deepcopy(content())
    change(broken)
    with pytest.raises(InputError, match=message):
        validate(broken)


def test_calls_take_turns() -> None:
    order: list[str] = []
    calls = {"a": lambda: order.append("a"), "b": lambda: order.append("b")}
    times = time_interleaved(calls, rounds=2, warm_up=1, repeats={"b": 2})
    assert "".join(order) == "abb" * 3
    assert {name: len(t) for name, t in times.items()} == {"a": 2, "b": 2}


def test_overrides_keep_the_types_of_their_defaults(capsys: pytest.CaptureFixture[str]) -> None:
    defaults = {"views": 40, "growth": True, "out": ""}
    found = overrides(defaults, ["views=7", "growth=false", "out=a=b c"])
    assert found == {"views": 7, "growth": False, "out": "a=b c"}
    for wrong in ("view=7", "views", "views=many", "growth=no"):
        with pytest.raises(SystemExit) as stop:
            overrides(defaults, [wrong])
        assert stop.value.code == 2
        assert wrong in capsys.readouterr().err
