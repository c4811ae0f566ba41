"""Measured poses from CSV: what is understood, and what is refused in one line."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hybrid.calibration import Measurements, read_measurements
from hybrid.errors import CalibrationError

JOINTS = ("shoulder", "elbow")
TURN = Rotation.from_rotvec([[0.1, -0.2, 0.3], [1.0, 0.5, -0.7]])


def read(tmp_path, header, *rows):
    path = tmp_path / "poses.csv"
    path.write_text("\n".join([header, *rows]) + "\n", encoding="utf-8")
    return read_measurements(path, JOINTS)


def test_joints_go_by_number_or_by_name(tmp_path):
    a = read(tmp_path, "q1,q2,x,y,z", "1,2,3,4,5")
    b = read(tmp_path, "z;y;x;q_elbow;q_shoulder", "5;4;3;2;1")
    np.testing.assert_array_equal(a.q, b.q)
    np.testing.assert_array_equal(a.position, b.position)
    assert a.kind == "position"


@pytest.mark.parametrize(
    "labels", ["q1 [deg],q2 (rad),x [mm],y [m],z[mm]", "q1/deg,q2,x / mm,y/m,z /mm"]
)
def test_units_become_metres_and_radians(tmp_path, labels):
    data = read(tmp_path, labels, "180,1,1000,2,3", "0,0,0,0,0")
    np.testing.assert_allclose(data.q[0], [np.pi, 1.0])
    np.testing.assert_allclose(data.position[0, 0], [1.0, 2.0, 0.003])


@pytest.mark.parametrize(
    ("names", "values"),
    [
        ("qx,qy,qz,qw", 3 * TURN.as_quat()),
        ("rx,ry,rz", TURN.as_rotvec()),
        ("roll,pitch,yaw", TURN.as_euler("xyz")),
        ("roll [deg],pitch [deg],yaw [deg]", TURN.as_euler("xyz", degrees=True)),
    ],
)
def test_every_way_to_write_an_orientation_means_the_same(tmp_path, names, values):
    rows = [",".join(map(repr, [0.0] * 5 + row)) for row in values.tolist()]
    data = read(tmp_path, f"q1,q2,x,y,z,{names}", *rows)
    np.testing.assert_allclose(data.rotation, TURN.as_matrix(), atol=1e-14)
    assert data.kind == "pose"


def test_several_reflectors_are_read_and_unseen_ones_are_gaps(tmp_path):
    data = read(
        tmp_path, "q1,q2,x1,y1,z1,x_2,y_2,z_2", "0,0,1,2,3,4,5,6", "0,0,,,,4,nan,6"
    )
    assert data.reflectors == 2
    np.testing.assert_array_equal(data.position[0], [[1, 2, 3], [4, 5, 6]])
    assert np.isnan(data.position[1, 0]).all()


def test_distances_keep_the_order_of_their_stations(tmp_path):
    data = read(tmp_path, "distance_2,q1,q2,distance", "2,0,0,1")
    np.testing.assert_array_equal(data.distance, [[1.0, 2.0]])
    assert data.kind == "distance"


@pytest.mark.parametrize(
    ("header", "row", "message"),
    [
        ("q1,x,y,z", "0,1,2,3", "no position of joint 'elbow'; valid is a column q2"),
        ("q1,q2", "0,0", "no measured points or distances; valid are q1"),
        ("q1,q2,x,y", "0,0,1,2", "no column z of point 1"),
        ("q1,q2,x,y,z,qx,qy,qz", "0,0,1,2,3,0,0,0", "valid are qx, qy, qz, qw"),
        ("q1,q2,x,y,z,qx,qy,qz,qw", "0,0,1,2,3,0,0,0,0", "quaternion of length zero"),
        ("q1,q2,x,y,z,foo", "0,0,1,2,3,4", "unknown column foo; valid are"),
        ("q1,q2,x [inch],y,z", "0,0,1,2,3", "is in inch; valid are m, mm, rad"),
        ("q1,q2,x,y,z", "0,0,1,2", "row 1 .* has 4 cells; valid are 5"),
        ("q1,q2,x,y,z", "0,0,one,2,3", "x, row 1 .*: 'one' is not a number"),
        ("q1,q2,x,y,z", ",0,1,2,3", "pose 1 has a joint position that is no number"),
        ("q1,q2,x,x,z", "0,0,1,2,3", "two columns 'x'"),
        ("q1,q2,x,y,z,distance", "0,0,1,2,3,4", "points or distances, not both"),
        ("q1,q2,x,y,z", "", "no rows below the column names"),
    ],
)
def test_bad_files_are_refused_in_one_line(tmp_path, header, row, message):
    with pytest.raises(CalibrationError, match=message) as caught:
        read(tmp_path, header, row)
    assert "poses.csv" in str(caught.value)


def test_a_missing_file_is_said_to_be_missing(tmp_path):
    with pytest.raises(CalibrationError, match="No such file"):
        read_measurements(tmp_path / "none.csv", JOINTS)


def test_arrays_of_other_shapes_are_refused():
    q = np.zeros((4, 2))
    with pytest.raises(CalibrationError, match=r"valid is \(N, r, 3\)"):
        Measurements(q, np.zeros((4, 3)))
    with pytest.raises(CalibrationError, match="rotation has shape"):
        Measurements(q, np.zeros((4, 1, 3)), np.zeros((4, 3)))
    with pytest.raises(CalibrationError, match="an orientation goes with one point"):
        Measurements(q, np.zeros((4, 2, 3)), np.zeros((4, 3, 3)))


def test_only_a_quaternion_of_length_zero_is_refused(tmp_path):
    header = "q1,q2,x,y,z,qx,qy,qz,qw"
    data = read(tmp_path, header, "0,0,1,2,3,0,0,0,1", "0,0,1,2,3,0,0,0,-2")
    np.testing.assert_allclose(data.rotation, [np.eye(3)] * 2, atol=1e-15)
    good = ["0,0,1,2,3,.5,.5,.5,.5"] * 2
    with pytest.raises(CalibrationError, match="quaternion of length zero"):
        read(tmp_path, header, *good, "0,0,1,2,3,0,0,0,0")
