from mapfusion_cli.options import MAX_ALL_CELLS, MAX_CHUNK_MIB, MAX_MAP_CELLS, MAX_MESSAGES, MAX_ROBOTS
from mapfusion_cli.printing import LONGEST_LINE, one_line, two_lines
from mapfusion_io.read_limits import ReadLimits


def test_a_line_stays_one_line_of_bounded_length() -> None:
    assert one_line("a\nb\x1b[2J\u202e\t") == r"a\nb\x1b[2J\u202e\t"
    assert one_line("caf\u00e9 \u6f22") == "caf\u00e9 \u6f22"
    assert len(one_line("x" * 10_000)) == LONGEST_LINE


def test_an_error_has_two_lines_at_most() -> None:
    assert two_lines("what\ndo\nmore\r") == "what\ndo\\nmore\\r"
    assert two_lines("what") == "what"


def test_the_options_have_the_defaults_of_the_limits() -> None:
    limits = ReadLimits()
    assert (
        limits.record_bytes,
        limits.map_cells,
        limits.all_cells,
        limits.messages,
        limits.robots,
    ) == (MAX_CHUNK_MIB * 2**20, MAX_MAP_CELLS, MAX_ALL_CELLS, MAX_MESSAGES, MAX_ROBOTS)
