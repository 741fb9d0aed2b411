"""Lips as other tools see them: one JSON line per frame of a video, on stdout. Needs the tool, OpenCV and numpy only.

    python benchmarks/other_landmarks.py mediapipe VIDEO...
    python benchmarks/other_landmarks.py dlib VIDEO...

dlib's file of 68 points is the one that DLIB_PREDICTOR names, or that of the package face_recognition_models.

A line has `video`, `frame`, `inner` (the inner lips as a polygon of x, y in px) and `ends` (of the mouth), or null for
both where no face was found. It is run by validate_others.py, in an environment of its own.
"""

from __future__ import annotations

import importlib.util
import json
import os
import sys
from pathlib import Path

import cv2

# the ring of the inner lips and the ends of the mouth in each tool's numbering
MESH_INNER = (78, 191, 80, 81, 82, 13, 312, 311, 310, 415, 308, 324, 318, 402, 317, 14, 87, 178, 88, 95)
MESH_ENDS = (61, 291)
POINTS_INNER, POINTS_ENDS = tuple(range(60, 68)), (48, 54)


def mediapipe_lips():
    """Function from an RGB picture to (inner, ends) or None; keeps track of a face within a video."""
    import mediapipe

    if not hasattr(mediapipe, "solutions"):
        raise ImportError(f"mediapipe {mediapipe.__version__} brings no model; versions up to 0.10.21 do")
    mesh = mediapipe.solutions.face_mesh.FaceMesh(max_num_faces=1, refine_landmarks=True)

    def lips(rgb):
        found = mesh.process(rgb).multi_face_landmarks
        if not found:
            return None
        height, width = rgb.shape[:2]
        points = found[0].landmark  # from 0 to 1 of the picture, whose edges lie half a pixel outside of pixel centres

        def place(k):
            return points[k].x * width - 0.5, points[k].y * height - 0.5

        return [place(k) for k in MESH_INNER], [place(k) for k in MESH_ENDS]

    return lips


def packaged_predictor() -> str | None:
    """The file of 68 points in the package face_recognition_models, None where that is not installed."""
    package = importlib.util.find_spec("face_recognition_models")  # not imported: it asks for more packages
    if package is None:
        return None
    return str(Path(package.submodule_search_locations[0]) / "models" / "shape_predictor_68_face_landmarks.dat")


def dlib_lips():
    """As above; a face is looked for in every frame."""
    import dlib

    predictor = os.environ.get("DLIB_PREDICTOR") or packaged_predictor()
    if not predictor:
        raise ImportError("dlib brings no file of landmarks; set DLIB_PREDICTOR or install face_recognition_models")
    find, shape = dlib.get_frontal_face_detector(), dlib.shape_predictor(predictor)

    def lips(rgb):
        faces = find(rgb, 1)
        if not faces:
            return None
        points = shape(rgb, max(faces, key=lambda face: face.area()))
        place = [(float(points.part(k).x), float(points.part(k).y)) for k in range(68)]
        return [place[k] for k in POINTS_INNER], [place[k] for k in POINTS_ENDS]

    return lips


TOOLS = {"mediapipe": mediapipe_lips, "dlib": dlib_lips}


def main(tool: str, videos: list[str]) -> int:
    try:
        TOOLS[tool]()
    except ImportError as error:
        print(f"{tool} cannot be used: {error}", file=sys.stderr)
        return 3
    for video in videos:
        lips = TOOLS[tool]()
        reader = cv2.VideoCapture(video)
        if not reader.isOpened():
            print(f"expected a video that can be read, got {video}", file=sys.stderr)
            return 2
        frame = 0
        while True:
            there, bgr = reader.read()
            if not there:
                break
            found = lips(cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB))
            inner, ends = found or (None, None)
            print(json.dumps({"video": video, "frame": frame, "inner": inner, "ends": ends}), flush=True)
            frame += 1
    return 0


if __name__ == "__main__":
    if len(sys.argv) < 3 or sys.argv[1] not in TOOLS:
        sys.exit(f"expected a tool of {', '.join(TOOLS)} and videos, got {' '.join(sys.argv[1:]) or 'nothing'}")
    sys.exit(main(sys.argv[1], sys.argv[2:]))
