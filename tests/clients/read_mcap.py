"""Compares an MCAP export with the CSV export of the same capture, message by message.

    dbbd export RUN --out DIR; dbbd export RUN --out DIR --mcap
    python3 read_mcap.py DIR/RUN.mcap DIR          (pip install mcap)
"""

import csv
import json
import sys
from pathlib import Path

from mcap.reader import make_reader

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
    assert set(channels) == {"raw", "samples", "faults", "events", "gaps"}, channels
    for attachment in reader.iter_attachments():
        print(f"attachment: {attachment.name}, {attachment.media_type}, {len(attachment.data)} bytes")

    def messages(topic):
        last = 0
        for _, _, message in reader.iter_messages(topics=[topic], log_time_order=False):
            assert message.log_time >= last or topic != "raw"
            last = message.log_time
            yield json.loads(message.data)

    compared = 0
    for topic in channels:
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
