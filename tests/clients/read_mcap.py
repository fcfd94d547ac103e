"""Compares an MCAP export with the CSV export of the same capture, message by message.

    dbbd export RUN --out DIR; dbbd export RUN --out DIR --mcap
    python3 read_mcap.py DIR/RUN.mcap DIR          (pip install mcap mcap-protobuf-support)

The transforms of the robot and its bar are decoded by the schema in the file. It ends with 77 where a package is missing.
"""

import csv
import json
import sys
from pathlib import Path

try:
    from mcap.reader import make_reader
    from mcap_protobuf.decoder import DecoderFactory
except ImportError as missing:
    print(f"SKIPPED: a run as MCAP: {missing}")
    sys.exit(77)

mcap, directory = Path(sys.argv[1]), Path(sys.argv[2])


def number(text):
    return None if text == "" else float(text)


def rows(name):
    with open(directory / f"{name}.csv", newline="") as file:
        yield from csv.DictReader(file)


with open(mcap, "rb") as file:
    reader = make_reader(file, validate_crcs=True)
    summary = reader.get_summary()
    channels = {channel.topic: channel.id for channel in summary.channels.values()}
    counts = {topic: summary.statistics.channel_message_counts.get(id, 0) for topic, id in channels.items()}
    print("channels:", ", ".join(f"{topic} ({count})" for topic, count in sorted(counts.items())))
    assert set(channels) == {"raw", "samples", "faults", "events", "gaps", "axes", "tf", "scene"}, channels
    for attachment in reader.iter_attachments():
        print(f"attachment: {attachment.name}, {attachment.media_type}, {len(attachment.data)} bytes")

    def messages(topic):
        last = 0
        for _, _, message in reader.iter_messages(topics=[topic], log_time_order=False):
            assert message.log_time >= last or topic != "raw"
            last = message.log_time
            yield json.loads(message.data)

    compared = 0
    for topic in sorted(set(channels) - {"axes", "tf", "scene"}):
        pairs = zip(rows(topic), messages(topic), strict=True)
        for row, message in pairs:
            assert int(row["host_ns"]) == message["host_ns"], (topic, row, message)
            compared += 1
            if topic == "raw":
                assert row["bytes_hex"] == message["bytes_hex"]
            elif topic == "samples":
                for name in ["reading_mm", "sequence", "ticks", "temperature_c", "status", "offset"]:
                    assert number(row[name]) == message[name], (name, row, message)
                assert row["valid"] == str(int(message["valid"]))
                trigger = message["trigger"]
                assert row["trigger"] == ("" if trigger is None else str(int(trigger)))
            elif topic == "events":
                assert row["event"] == message["event"]
                detail = json.loads(row["detail_json"])
                assert all(message[name] == value for name, value in detail.items()), (row, message)
            elif topic == "gaps":
                assert row["reason"] == message["reason"]
                assert number(row["missing"]) == message["missing"]
            else:
                assert int(row["offset"]) == message["offset"] and int(row["bytes"]) == message["bytes"]
    print(f"{compared} messages agree with the CSV export")

with open(mcap, "rb") as file:
    reader = make_reader(file, decoder_factories=[DecoderFactory()])
    links, lengths = set(), []
    for _, channel, _, message in reader.iter_decoded_messages(topics=["tf", "scene"]):
        if channel.topic == "tf":
            assert len(message.transforms) == 8
            for transform in message.transforms:
                rotation = transform.rotation
                norm = rotation.x**2 + rotation.y**2 + rotation.z**2 + rotation.w**2
                assert abs(norm - 1) < 1e-12 and transform.parent_frame_id == "base_link"
                links.add(transform.child_frame_id)
            ball = message.transforms[7].translation
        else:
            assert [entity.id for entity in message.entities] == ["base balls", "bar"]
            start, end = message.entities[1].lines[0].points
            assert abs(end.x - ball.x) + abs(end.y - ball.y) + abs(end.z - ball.z) < 1e-12
            lengths.append(1e3 * ((end.x - start.x) ** 2 + (end.y - start.y) ** 2 + (end.z - start.z) ** 2) ** 0.5)
    assert links == {*(f"link_{number}" for number in range(1, 7)), "flange", "ball"}, links
    print(f"{len(lengths)} scenes; the bar is {min(lengths):.3f} to {max(lengths):.3f} mm long")
    assert max(lengths) - min(lengths) < 10, "the bar is longer than its stroke"
