"""Runs ORB-SLAM3 on images; run by the interpreter of its own environment, never imported here.

Reads a job (JSON) from standard input and writes the result (JSON) to the file the job names, because ORB-SLAM3 writes
to standard output itself.

Job: ``{"images": .npy of (n, height, width) uint8, "times_s": [n], "pace": share of real time, "settings": YAML file,
"vocabulary": text file, "result": file to write}``. An image is due one interval (over pace) after the previous one was
handed over: mapping runs in other threads and gets the time it would have on a car, also on a busy machine.

Result, times in seconds: per image ``"poses"`` (4 x 4 world from camera as nested lists; null unless its state is OK),
``"tracking_s"`` (CPU of the calling thread) and ``"late_s"`` (how long after its due time the image was handed over);
of the whole process ``"process_s"`` (CPU of all threads over all images).
"""

# pyright: reportMissingImports=false
from __future__ import annotations

import json
import os
import sys
import time
from pathlib import Path

import numpy as np
import pyorbslam3


def main() -> None:
    """Do the job on standard input."""
    job = json.load(sys.stdin)
    images = np.load(job["images"], mmap_mode="r")
    slam = pyorbslam3.Slam(job["vocabulary"], job["settings"], pyorbslam3.Sensor.MONOCULAR)
    result: dict = {"poses": [], "tracking_s": [], "late_s": []}
    begun_process = time.process_time()
    handed, before = time.monotonic(), job["times_s"][0]
    for image, at in zip(images, job["times_s"], strict=True):
        due = handed + (at - before) / job["pace"]
        time.sleep(max(0.0, due - time.monotonic()))
        handed, before = time.monotonic(), at
        result["late_s"].append(max(0.0, handed - due))
        start = time.thread_time()
        found = slam.track_monocular(np.ascontiguousarray(image), at)
        result["tracking_s"].append(time.thread_time() - start)
        result["poses"].append(np.asarray(found.pose_wc).tolist() if found.ok and found.pose_valid else None)
    result["process_s"] = time.process_time() - begun_process
    Path(job["result"]).write_text(json.dumps(result), encoding="ascii")
    # Its threads need not end in good order: nothing of theirs is wanted any more.
    sys.stdout.flush()
    os._exit(0)


main()
