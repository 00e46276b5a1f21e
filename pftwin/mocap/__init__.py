"""From files of a motion laboratory to poses of segments: read, fill, filter, fit."""

from pftwin.mocap.c3d import read_c3d
from pftwin.mocap.csv_files import read_csv, read_marker_csv, write_csv
from pftwin.mocap.filters import butterworth_lowpass, singular_spectrum_filter
from pftwin.mocap.frames import cluster_poses, mean_cluster, segment_poses, three_point_frames
from pftwin.mocap.gaps import Gap, fill_gaps, find_gaps
from pftwin.mocap.markers import MarkerTrajectories
from pftwin.mocap.mirror import mirror_left_markers, mirror_left_poses
from pftwin.mocap.poses import PoseSeries, read_poses_csv
from pftwin.mocap.reading import read_markers
from pftwin.mocap.sto import read_sto
from pftwin.mocap.tables import Table
from pftwin.mocap.trc import read_trc, write_trc

__all__ = [
    "Gap",
    "MarkerTrajectories",
    "PoseSeries",
    "Table",
    "butterworth_lowpass",
    "cluster_poses",
    "fill_gaps",
    "find_gaps",
    "mean_cluster",
    "mirror_left_markers",
    "mirror_left_poses",
    "read_c3d",
    "read_csv",
    "read_marker_csv",
    "read_markers",
    "read_poses_csv",
    "read_sto",
    "read_trc",
    "segment_poses",
    "singular_spectrum_filter",
    "three_point_frames",
    "write_csv",
    "write_trc",
]
