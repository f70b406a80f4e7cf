"""Tables of positions come in as they were meant, whoever wrote them, or are refused where that is not clear."""

from __future__ import annotations

import codecs
from pathlib import Path

import pytest

from xfreqbench.errors import DataError
from xfreqbench.scene.tables import read_table

PLACES_M = [[1.0, 2.5, 1.2], [3.5, 1.5, 0.9]]
PLAIN = "1.0,2.5,1.2\n3.5,1.5,0.9\n"


@pytest.mark.parametrize(
    "content",
    [
        PLAIN.encode(),
        PLAIN.replace("\n", "\r").encode(),
        codecs.BOM_UTF8 + PLAIN.replace("\n", "\r\n").encode(),
        codecs.BOM_UTF16_LE + PLAIN.encode("utf-16-le"),
        PLAIN.replace(",", " ").encode(),
        PLAIN.replace(",", ";").encode(),
        PLAIN.replace(",", ",  ").encode(),
        b"x,y,z\n" + PLAIN.encode(),
        b",x,y,z\n0,1.0,2.5,1.2\n1,3.5,1.5,0.9\n",
        b'"","x","y","z"\n"1",1.0,2.5,1.2\n"2",3.5,1.5,0.9\n',
        b"z [m],room,X_m,y (m)\n1.2,7,1.0,2.5\n0.9,8,3.5,1.5\n",
        b"# z y x\n1.2 2.5 1.0\n0.9 1.5 3.5\n",
        b"x,y,z,2\n1.0,2.5,1.2,-40\n3.5,1.5,0.9,\n",
        b"# positions x y z\n\n1.0 2.5 1.2 # by the door\n3.5 1.5 .9",
        b"# y x z\n# surveyed in May\n\n2.5,1.0,1.2\n1.5,3.5,0.9\n",
        b"# columns: z,y,x\n1.2 2.5 1.0\n0.9 1.5 3.5\n",
        b"# z, y and x of the room\nx,y,z\n" + PLAIN.encode() + b",,\n",
        b"1.0,2.5,1.2,kitchen\n3.5,1.5,0.9,\n",
    ],
)
def test_columns_are_found_by_their_names_or_are_three_of_numbers(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "tx.csv").write_bytes(content)
    assert read_table(tmp_path / "tx.csv").position_m().tolist() == PLACES_M


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("0,1.0,2.5,1.2\n1,3.5,1.5,0.9\n", "4 columns of numbers and no names of columns"),  # an index
        ("0,1.0,2.5\n1,3.5,1.5\n", "may count lines"),  # an index, and no z
        ("0,1,2\n1.0,2.5,1.2\n", "may count lines or columns"),  # pandas' names of the columns of an array
        ("1,0,2,5,1,2\n3,5,1,5,0,9\n", "6 columns of numbers"),  # decimal commas
        ("x,y,z\n1,0,2,5,1,2\n", "line 2, is '1,0,2,5,1,2'"),
        ("1,0;2,5;1,2\n", "decimal points"),
        ('"1,0","2,5","1,2"\n', "decimal points"),
        ("1.0,2.5\n3.5,1.5\n", "2 columns of numbers"),
        ("tx1,1,2,3\nend\n", "line 2, is 'end', 1 cells for 4 columns"),
        ("1,2,3\n1,2,3,4\n", "line 2, is '1,2,3,4'"),
        ("x_mm,y_mm,z_mm\n1,2,3\n", "has the columns 'x_mm, y_mm, z_mm', not one each for x and y and z"),
        ("# x [mm], y [mm], z [mm]\n1,2,3\n", "not one each for x and y and z"),
        ("1.0,nan,2.5,1.2\n", "4 columns of numbers"),
        ("x,y,z,z\n1,2,3,4\n", "not one each for x and y and z"),
        ("1_0,2,3\n", "line 1, has '1_0' in column 1, which is not a finite number"),
        ("x,y,z\n1,nan,3\n", "line 2, has 'nan' in column y"),
        ("1,2,1e308\n", "line 1, has '1e308' in column 3, which is not a finite number .* up to 1e"),
        ("x,y,z\n", "has no position"),
        ("", "has no position"),
    ],
)
def test_what_can_be_read_in_two_ways_is_refused(tmp_path: Path, text: str, told: str) -> None:
    (tmp_path / "tx.csv").write_text(text)
    with pytest.raises(DataError, match=told):
        read_table(tmp_path / "tx.csv").position_m()
