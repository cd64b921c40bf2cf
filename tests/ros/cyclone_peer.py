"""A participant on Eclipse Cyclone DDS, a stack that shares no code with ROS's Fast DDS nor with this simulator.

    python tests/ros/cyclone_peer.py RESULT.json [PATTERN.json BODY.npz]

Publishes the pattern and the body, if they are given, and writes what it has received once a report has come in that is
of a garment on a body. Its types are written down from the .msg files; XCDR version 1, as ROS 2 sends.
"""

import hashlib
import json
import os
import struct
import sys
import time
from dataclasses import dataclass
from pathlib import Path

os.environ["CYCLONEDDS_URI"] = """
<CycloneDDS><Domain id="any">
  <General>
    <AllowMulticast>false</AllowMulticast>
    <Interfaces><NetworkInterface address="127.0.0.1"/></Interfaces>
  </General>
  <Discovery>
    <ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>32</MaxAutoParticipantIndex>
    <Peers><Peer Address="127.0.0.1"/></Peers>
  </Discovery>
</Domain></CycloneDDS>
"""

from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import array, float32, float64, int32, sequence, uint8, uint32
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

PATIENCE = 120.0
"""[s]."""


@dataclass
class Time(IdlStruct, typename="builtin_interfaces::msg::dds_::Time_"):
    sec: int32
    nanosec: uint32


@dataclass
class Duration(IdlStruct, typename="builtin_interfaces::msg::dds_::Duration_"):
    sec: int32
    nanosec: uint32


@dataclass
class Header(IdlStruct, typename="std_msgs::msg::dds_::Header_"):
    stamp: Time
    frame_id: str


@dataclass
class String(IdlStruct, typename="std_msgs::msg::dds_::String_"):
    data: str


@dataclass
class ColorRGBA(IdlStruct, typename="std_msgs::msg::dds_::ColorRGBA_"):
    r: float32
    g: float32
    b: float32
    a: float32


@dataclass
class Point(IdlStruct, typename="geometry_msgs::msg::dds_::Point_"):
    x: float64
    y: float64
    z: float64


@dataclass
class Vector3(IdlStruct, typename="geometry_msgs::msg::dds_::Vector3_"):
    x: float64
    y: float64
    z: float64


@dataclass
class Quaternion(IdlStruct, typename="geometry_msgs::msg::dds_::Quaternion_"):
    x: float64
    y: float64
    z: float64
    w: float64


@dataclass
class Pose(IdlStruct, typename="geometry_msgs::msg::dds_::Pose_"):
    position: Point
    orientation: Quaternion


@dataclass
class MeshTriangle(IdlStruct, typename="shape_msgs::msg::dds_::MeshTriangle_"):
    vertex_indices: array[uint32, 3]


@dataclass
class Mesh(IdlStruct, typename="shape_msgs::msg::dds_::Mesh_"):
    triangles: sequence[MeshTriangle]
    vertices: sequence[Point]


@dataclass
class CompressedImage(IdlStruct, typename="sensor_msgs::msg::dds_::CompressedImage_"):
    header: Header
    format: str
    data: sequence[uint8]


@dataclass
class UVCoordinate(IdlStruct, typename="visualization_msgs::msg::dds_::UVCoordinate_"):
    u: float32
    v: float32


@dataclass
class MeshFile(IdlStruct, typename="visualization_msgs::msg::dds_::MeshFile_"):
    filename: str
    data: sequence[uint8]


@dataclass
class Marker(IdlStruct, typename="visualization_msgs::msg::dds_::Marker_"):
    header: Header
    ns: str
    id: int32
    type: int32
    action: int32
    pose: Pose
    scale: Vector3
    color: ColorRGBA
    lifetime: Duration
    frame_locked: bool
    points: sequence[Point]
    colors: sequence[ColorRGBA]
    texture_resource: str
    texture: CompressedImage
    uv_coordinates: sequence[UVCoordinate]
    text: str
    mesh_resource: str
    mesh_file: MeshFile
    mesh_use_embedded_materials: bool


LATCHED = Qos(
    Policy.Reliability.Reliable(duration(seconds=1)),
    Policy.Durability.TransientLocal,
    Policy.History.KeepLast(1),
    Policy.DataRepresentation(use_cdrv0_representation=True),
)


def points_sha256(marker: Marker) -> str:
    """Of the coordinates as little-endian float64."""
    return hashlib.sha256(b"".join(struct.pack("<3d", p.x, p.y, p.z) for p in marker.points)).hexdigest()


def main() -> int:
    result, *inputs = map(Path, sys.argv[1:])
    participant = DomainParticipant(int(os.environ["ROS_DOMAIN_ID"]))

    def topic(name: str, kind: type) -> Topic:
        return Topic(participant, f"rt/cloth_sim/{name}", kind, qos=LATCHED)

    writers = []
    if inputs:
        import numpy as np

        body = np.load(inputs[1])
        mesh = Mesh(
            triangles=[MeshTriangle(vertex_indices=row) for row in body["triangles"].tolist()],
            vertices=[Point(*row) for row in body["vertices"].tolist()],
        )
        writers = [DataWriter(participant, topic(name, kind)) for name, kind in (("pattern", String), ("body", Mesh))]
        for writer, message in zip(writers, (String(data=inputs[0].read_text()), mesh), strict=True):
            writer.write(message)
        print("published", flush=True)
    kinds = {"garment": Marker, "body_marker": Marker, "report": String}
    readers = {name: DataReader(participant, topic(name, kind)) for name, kind in kinds.items()}
    received: dict[str, list] = {name: [] for name in kinds}
    deadline = time.monotonic() + PATIENCE
    complete_since = None
    while time.monotonic() < deadline:
        for name, reader in readers.items():
            received[name] += reader.take(100)
        reports = [json.loads(message.data) for message in received["report"]]
        if any(report["body"] for report in reports) and received["garment"] and received["body_marker"]:
            # Topics are independent of each other: the last frame may come after the report.
            complete_since = complete_since or time.monotonic()
            if time.monotonic() > complete_since + 0.5:
                break
        time.sleep(0.02)
    else:
        print({name: len(messages) for name, messages in received.items()}, file=sys.stderr)
        return 1
    garment, marker = received["garment"][-1], received["body_marker"][-1]
    content = {
        "frames": len(received["garment"]),
        "garment": points_sha256(garment),
        "garment_fields": [garment.header.frame_id, garment.ns, garment.id, garment.type, garment.action],
        "color": [marker.color.r, marker.color.g, marker.color.b, marker.color.a],
        "body_marker": points_sha256(marker),
        "report": reports[-1],
    }
    result.write_text(json.dumps(content))
    return 0


if __name__ == "__main__":
    sys.exit(main())
