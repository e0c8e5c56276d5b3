"""The tables of a recording, as CSV and as Parquet."""

import csv

import numpy
import pandas
import pyarrow
import pytest
from conftest import decoded, nanos, pb3dp
from pyarrow import parquet

TABLES = ["estimates", "timeseries"]


@pytest.fixture(scope="module")
def tables(run, tmp_path_factory):
    """The folder with the tables of the run."""
    folder = tmp_path_factory.mktemp("tables") / "report"
    pb3dp("report", run / "run.mcap", "--out", folder)
    return folder


def bits(column):
    """The bits of numbers; all unknown numbers are one."""
    return numpy.where(column.isna(), numpy.nan, column.to_numpy(float)).view(numpy.int64)


@pytest.mark.parametrize("name", TABLES)
def test_pandas_reads_the_same_table_from_both_files(tables, name):
    # Only an empty cell is unknown: words such as NA are words.
    text = pandas.read_csv(tables / f"{name}.csv", keep_default_na=False, na_values=[""])
    table = pandas.read_parquet(tables / f"{name}.parquet")
    assert len(table) > 0 and list(table.columns) == list(text.columns)
    for column in table.columns:
        if pandas.api.types.is_numeric_dtype(text[column]):
            assert table[column].dtype == numpy.float64, column
            assert (bits(table[column]) == bits(text[column])).all(), column
        else:
            pandas.testing.assert_series_equal(table[column], text[column])


@pytest.mark.parametrize("name", TABLES)
def test_columns_are_nullable_numbers_or_strings_and_empty_cells_are_null(tables, name):
    table = parquet.read_table(tables / f"{name}.parquet")
    with (tables / f"{name}.csv").open(newline="") as text:
        rows = list(csv.DictReader(text))
    assert table.num_rows == len(rows)
    for field, column in zip(table.schema, table.columns):
        assert field.nullable and field.type in (pyarrow.float64(), pyarrow.string()), field
        assert column.is_null().to_pylist() == [row[field.name] == "" for row in rows], field
        known = [row[field.name] for row in rows if row[field.name]]
        numbers = field.type == pyarrow.float64()
        assert column.drop_null().to_pylist() == ([float(cell) for cell in known] if numbers else known), field


def test_the_words_of_a_table_are_strings_and_everything_else_is_a_number(tables):
    for name, words in (("estimates", ["status"]), ("timeseries", ["mode"])):
        schema = parquet.read_schema(tables / f"{name}.parquet")
        assert [field.name for field in schema if field.type == pyarrow.string()] == words


def rotation(quaternion):
    """The matrix of a unit quaternion x, y, z, w."""
    x, y, z, w = quaternion
    return numpy.array([[1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)]])


def test_the_estimates_are_the_poses_of_the_recording(run, tables):
    table = pandas.read_parquet(tables / "estimates.parquet")
    table = table[table.x_mm.notna()]
    messages = [message for _, message in decoded(run / "run.mcap")["/pb3dp/pose"]]
    assert len(messages) == len(table) > 0
    # Cells have six decimals of a second, four of a millimetre and seven of a quaternion.
    stamps = numpy.array([nanos(message.header) for message in messages])
    times = table.t_s.to_numpy()
    assert numpy.allclose((stamps - stamps[0]) * 1e-9, times - times[0], rtol=0, atol=2e-6)
    poses = [message.pose.pose for message in messages]
    positions = [[pose.position.x, pose.position.y, pose.position.z] for pose in poses]
    assert numpy.allclose(numpy.array(positions) * 1e3, table[["x_mm", "y_mm", "z_mm"]], rtol=0, atol=6e-5)
    of_messages = numpy.array([[q.x, q.y, q.z, q.w] for q in (pose.orientation for pose in poses)])
    of_table = table[["qx", "qy", "qz", "qw"]].to_numpy()
    signs = numpy.sign((of_messages * of_table).sum(axis=1, keepdims=True))
    assert numpy.allclose(of_messages, signs * of_table, rtol=0, atol=1e-7)
    # The table has the covariance of the pose along the axes of the model in mm and rad, the message along those of the camera in m and rad.
    names = [f"p{row}{column}" for row in range(1, 7) for column in range(1, 7)]
    units = numpy.diag([1e-3] * 3 + [1.0] * 3)
    for message, quaternion, cells in zip(messages, of_table, table[names].to_numpy()):
        turned = numpy.kron(numpy.eye(2), rotation(quaternion)) @ units
        expected = numpy.array(message.pose.covariance).reshape(6, 6)
        sigma = numpy.sqrt(numpy.diag(expected))
        found = turned @ cells.reshape(6, 6) @ turned.T
        assert numpy.allclose(found / numpy.outer(sigma, sigma), expected / numpy.outer(sigma, sigma), rtol=0, atol=1e-4)
