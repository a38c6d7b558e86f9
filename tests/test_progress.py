"""Progress: how much is done, and the time that is left."""

from pgran.run import task


def test_time_left_by_the_pace_of_now(monkeypatch, capsys):
    """What an earlier run had finished arrives at once, and says nothing about the pace."""
    now = 0.0
    monkeypatch.setattr(task.time, "monotonic", lambda: now)
    with task.Progress(1000, "steps", "lines") as counter:
        for seconds, count in [(1, 500), *[(1, 1)] * 30, (100, 0)]:  # nothing done says nothing
            now += seconds
            counter.advance(count)
    said = capsys.readouterr().err.splitlines()
    assert len(said) == 3
    assert said[-1] == "pgran: 529 of 1000 steps, about 7.8 min left"


def test_durations():
    for seconds, words in ((119, "120 s"), (600, "10 min"), (7200, "2 h"), (2e5, "2.3 days")):
        assert task.in_time(seconds) == words
