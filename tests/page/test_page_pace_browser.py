"""The kidney's drawing rests in proportion to its cost: the page's own script in a real browser, by simulated time."""

import itertools

import pytest
from browsing import BROWSED, chromium

from ursnav_torch.page import PageServer

pytest.importorskip("uvicorn")
pytestmark = BROWSED

#: For so many ms of simulated time drawings of so many ms each are asked for every 10 ms; tells when each began.
SIMULATED = """async ([url, lasts, cost, hurried]) => {
  const { paced } = await import(url);
  const begun = [], due = [];
  let now = 0;
  const later = (action, after) => due.push([now + after, action]);
  const clock = { now: () => now, later, frame: (action) => later(action, 0) };
  const view = paced(() => begun.push(now), () => new Promise((done) => later(done, cost)), clock);
  for (; now < lasts; now += 10) {
    if (hurried) view.askNow(); else view.ask();
    let ready;
    while ((ready = due.findIndex(([at]) => at <= now)) >= 0) {
      due.splice(ready, 1)[0][1]();
      for (let i = 0; i < 10; i++) await null;
    }
  }
  return begun;
}"""


@pytest.fixture(scope="module")
def simulated():
    """Call `SIMULATED` in a page of ours."""
    server = PageServer("live.html", {}, {}, ("127.0.0.1", 0))
    with chromium() as browser:
        tab = browser.new_page()
        tab.goto(f"{server.url}/static/icon.svg")
        yield lambda *given: tab.evaluate(SIMULATED, [f"{server.url}/static/pace.js", *given])
    server.stop()


@pytest.mark.parametrize("cost", [10, 40, 200, 1000])
def test_drawing_takes_a_share_of_the_time_whatever_it_costs(simulated, cost):
    begun = simulated(60_000, cost, False)
    share = len(begun) * cost / 60_000
    assert 0.1 <= share <= 0.25 and len(begun) >= 10


def test_what_a_hand_turns_is_drawn_at_once_and_never_two_at_a_time(simulated):
    begun = simulated(2_000, 200, True)
    apart = [b - a for a, b in itertools.pairwise(begun)]
    assert begun[0] <= 10 and all(200 <= gap <= 230 for gap in apart)
