"""Runs ORB-SLAM3 on images; run by the interpreter of its own environment, never imported here.

Reads a job (JSON) from standard input and writes the result (JSON) to the file the job names, because ORB-SLAM3 writes
to standard output itself.

Job: ``{"images": .npy of (n, height, width) uint8, "times_s": [n], "pace": share of real time or null, "settings": YAML
file, "vocabulary": text file, "result": file to write}``. With a pace an image is due one interval (over pace) after
the previous one was handed over: mapping runs in other threads and gets the time it would have on a car. On a machine
that does other things it would get less; therefore, without a pace, an image is due when these threads have come to
rest, or have had a processor for one interval: what a car with a core to spare would give them, at any load.

Result, times in seconds: per image ``"poses"`` (4 x 4 world from camera as nested lists; null unless its state is OK),
``"states"`` (its name of it), ``"matches"`` (map points tracked; 0 unless OK), ``"tracking_s"`` (CPU of the calling
thread) and ``"late_s"`` (how long after its due time the image was handed over); of the whole process ``"process_s"``
(CPU of all threads over all images).
"""

# pyright: reportMissingImports=false
from __future__ import annotations

import json
import os
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pyorbslam3

REST_POLLS, POLL_S = 4, 0.002  # resting threads look for work every 3 ms: so long without a running one is rest
PATIENCE_S = 10.0  # a processor may never come


def _running() -> bool:
    """Whether a thread beside this one runs, or would if it were given a processor."""
    own = threading.get_native_id()
    for task in Path("/proc/self/task").iterdir():
        if int(task.name) != own:
            try:
                stat = (task / "stat").read_text(encoding="ascii", errors="replace")
            except OSError:  # it has just ended
                continue
            if stat.rpartition(")")[2].split()[0] in "RD":
                return True
    return False


def _others_s() -> float:
    """Processor time of the threads beside this one so far."""
    return time.process_time() - time.thread_time()


def _rest(processor_s: float) -> None:
    """Wait until the threads beside this one are at rest, or have had so much processor time in all."""
    end, quiet = time.monotonic() + PATIENCE_S, 0
    while quiet < REST_POLLS and _others_s() < processor_s and time.monotonic() < end:
        time.sleep(POLL_S)
        quiet = 0 if _running() else quiet + 1


def main() -> None:
    """Do the job on standard input."""
    job = json.load(sys.stdin)
    images = np.load(job["images"], mmap_mode="r")
    slam = pyorbslam3.Slam(job["vocabulary"], job["settings"], pyorbslam3.Sensor.MONOCULAR)
    result: dict = {"poses": [], "states": [], "matches": [], "tracking_s": [], "late_s": []}
    begun_process = time.process_time()
    handed, before, worked_s = time.monotonic(), job["times_s"][0], _others_s()
    for image, at in zip(images, job["times_s"], strict=True):
        if job["pace"] is None:
            _rest(worked_s + at - before)
            due = time.monotonic()
        else:
            due = handed + (at - before) / job["pace"]
            time.sleep(max(0.0, due - time.monotonic()))
        handed, before, worked_s = time.monotonic(), at, _others_s()
        result["late_s"].append(max(0.0, handed - due))
        start = time.thread_time()
        found = slam.track_monocular(np.ascontiguousarray(image), at)
        result["tracking_s"].append(time.thread_time() - start)
        good = found.ok and found.pose_valid
        result["poses"].append(np.asarray(found.pose_wc).tolist() if good else None)
        result["states"].append(found.state.name)
        result["matches"].append(found.num_tracked_points if good else 0)
    result["process_s"] = time.process_time() - begun_process
    Path(job["result"]).write_text(json.dumps(result), encoding="ascii")
    # Its threads need not end in good order: nothing of theirs is wanted any more.
    sys.stdout.flush()
    os._exit(0)


main()
