"""`benchmarks.instructions`: which instructions in a dump of callgrind's are those of compiled programs."""

from benchmarks.instructions import counts

DUMP = """
ob=(1) /usr/lib/libpython.so
fn=(1) evaluate
10 100
cob=(2) ???
cfn=(2) 0x0000000000005000
calls=1 20
10 999
ob=(2)
fn=(2)
20 7
fn=(3) 0x0000000000001010'2
30 50
fn=(4) 0x0000000000006000
* 4
"""


def test_jump_tables_of_libraries_are_no_compiled_code() -> None:
    """Code at 0x5000 and 0x6000 is in no file; 0x1010 lies in a library. Costs of a call belong to the callee."""
    assert counts(DUMP, [(0x1000, 0x2000)]) == {"compiled": 11, "all": 161}
    assert counts(DUMP, []) == {"compiled": 61, "all": 161}
