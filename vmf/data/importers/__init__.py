"""Importers: from the folders and files in which others keep stereo data to the messages of a recording."""

from __future__ import annotations

from vmf.data.importers import csv, euroc, kitti, npz, rosbag2, tum
from vmf.data.importers.base import Format, Importable

FORMATS: dict[str, Format] = {
    "euroc": Format(euroc.EurocOptions, euroc.look),
    "tum": Format(tum.TumOptions, tum.look),
    "kitti": Format(kitti.KittiOptions, kitti.look),
    "npz": Format(npz.NpzOptions, npz.look),
    "csv": Format(csv.CsvOptions, csv.look),
    "rosbag2": Format(rosbag2.Rosbag2Options, rosbag2.Rosbag2),
}

__all__ = ["FORMATS", "Format", "Importable"]
