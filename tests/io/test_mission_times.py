from mapfusion.steps import RobotEvent
from mapfusion_io.mission import Mission, MissionOptions
from mapfusion_io.survey import Survey, take_survey
from mapfusion_io.time_range import TimeRange
from tests.io.fake_recordings import FakeRecording, Sender, grids, mission, ns, surveyed


def test_recordings_of_different_times_are_said_and_can_be_aligned() -> None:
    surveys = []
    for name, start in (("1", 100.0), ("2", 72_000.0)):
        send = Sender()
        surveys.append(
            surveyed(name, send.grid("/map", start + 5.0), send.transforms("/tf", start, ("map", "base_link")))
        )
    apart = Mission(surveys, MissionOptions())
    (warning,) = apart.warnings
    assert "do not overlap in time: 2 starts 20.0 hours after 1 ends" in warning
    assert "--align-start" in warning
    aligned = Mission(surveys, MissionOptions(align_start=True))
    assert aligned.warnings == ()
    assert grids(aligned) == [("1", 105.0), ("2", 105.0)]
    source = aligned.robots[1].poses.source
    assert source is not None
    assert source.stamps_ns.tolist() == [ns(100.0)]


def test_a_recording_that_covers_two_others_leaves_no_gap() -> None:
    def covering(name: str, *times_s: float) -> Survey:
        send = Sender()
        return surveyed(name, *(send.grid(f"/{name}/map", time_s, f"{name}/map") for time_s in times_s))

    surveys = [covering("a", 0.0, 100.0), covering("b", 10.0, 22.0), covering("c", 50.0, 62.0)]
    assert Mission(surveys, MissionOptions()).warnings == ()


def test_a_clock_that_differs_from_the_recorders_is_said() -> None:
    send = Sender()
    messages = [
        *(send.grid("/a/map", time_s, "a/map") for time_s in (20.0, 40.0)),
        *(send.grid("/b/map", time_s, "b/map", stamp_s=time_s + 37.0) for time_s in (21.0, 41.0)),
    ]
    (warning,) = mission(*messages).warnings
    assert "the clock of b is 37.0 s ahead of the recorder's" in warning
    assert "--clock log" in warning
    by_log = Mission([take_survey(FakeRecording("run.mcap", messages), "run", "log")], MissionOptions(clock="log"))
    assert by_log.warnings == ()
    assert grids(by_log) == [("a", 20.0), ("b", 21.0), ("a", 40.0), ("b", 41.0)]


def test_poses_are_clipped_to_the_time_range() -> None:
    send = Sender()
    made = mission(
        send.grid("/a/map", 0.0, "a/map"),
        *(send.pose("/a/pose", time_s, "a/map") for time_s in (0.0, 1.0, 2.0, 3.0)),
        time_range=TimeRange(start="1", duration_s=2.0),
    )
    (robot,) = [event for event in made.events() if isinstance(event, RobotEvent)]
    assert robot.poses is not None
    assert robot.poses.stamps_ns.tolist() == [ns(1.0), ns(2.0)]
