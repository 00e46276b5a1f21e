"""Motion capture: reads files, fills gaps, filters, and fits segments' poses to markers."""

from pftwin.files.mocap.bones import mended_bones
from pftwin.files.mocap.c3d import read_c3d, read_c3d_channels
from pftwin.files.mocap.csv_files import read_csv, read_marker_csv, write_csv
from pftwin.files.mocap.filters import Gap, butterworth_lowpass, fill_gaps, find_gaps, singular_spectrum_filter
from pftwin.files.mocap.frames import cluster_poses, mean_cluster, segment_poses, three_point_frames
from pftwin.files.mocap.joint_centers import JointCenter, sphere_center
from pftwin.files.mocap.markers import MarkerTrajectories
from pftwin.files.mocap.pose_files import read_poses
from pftwin.files.mocap.poses import PoseSeries, mirror_left_markers, mirror_left_poses
from pftwin.files.mocap.reading import frame_means, read_markers, read_readings
from pftwin.files.mocap.sto import read_sto
from pftwin.files.mocap.strays import Stray, mended_cluster
from pftwin.files.mocap.tables import Table
from pftwin.files.mocap.trc import read_trc, write_trc

__all__ = [
    "Gap",
    "JointCenter",
    "MarkerTrajectories",
    "PoseSeries",
    "Stray",
    "Table",
    "butterworth_lowpass",
    "cluster_poses",
    "fill_gaps",
    "find_gaps",
    "frame_means",
    "mean_cluster",
    "mended_bones",
    "mended_cluster",
    "mirror_left_markers",
    "mirror_left_poses",
    "read_c3d",
    "read_c3d_channels",
    "read_csv",
    "read_marker_csv",
    "read_markers",
    "read_poses",
    "read_readings",
    "read_sto",
    "read_trc",
    "segment_poses",
    "singular_spectrum_filter",
    "sphere_center",
    "three_point_frames",
    "write_csv",
    "write_trc",
]
