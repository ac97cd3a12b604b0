"""Compares what `uorb export` made of a flight log with the log itself.

Nothing of ours is in here: pyulog reads the log, its ulog2csv makes the tables
that ours are compared with, and the readers of mcap read the MCAP file.

    exported.py csv  LOG DIRECTORY    every table has the columns and values of ulog2csv's
    exported.py mcap LOG FILE.mcap    every message has the values that pyulog finds

It prints how many tables or channels, messages, and values it compared.
"""

import csv
import os
import re
import sys
import tempfile

import numpy as np
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from pyulog import ULog
from pyulog.ulog2csv import convert_ulog2csv


def is_padding(path):
    return any(step.startswith("_padding") for step in path.split("."))


def values(texts, field, dtype):
    """Values as they are compared: a truth value is one whatever its byte is."""
    if dtype.kind == "f":
        return np.array(texts, dtype=dtype)
    if field.type_str == "bool":
        return np.array([int(text) != 0 for text in texts])
    return np.array(texts)


def check(what, ours, theirs):
    is_float = theirs.dtype.kind == "f"
    assert np.array_equal(ours, theirs, equal_nan=is_float), f"{what}: {ours}, not {theirs}"
    return len(theirs)


def table(path):
    with open(path, encoding="utf-8", newline="") as file:
        head, *rows = csv.reader(file)
    columns = {}
    for number, name in enumerate(head):
        if not is_padding(name):
            columns[name] = [row[number] for row in rows]
    return columns


def compare_csv(log, directory):
    messages = compared = 0
    by_name = {f"{data.name}_{data.multi_id}": data for data in ULog(log).data_list}
    with tempfile.TemporaryDirectory() as theirs:
        sys.stdout = open(os.devnull, "w")
        convert_ulog2csv(log, None, theirs, ",", None, None)
        sys.stdout = sys.__stdout__
        assert sorted(os.listdir(directory)) == sorted(os.listdir(theirs))
        stem = os.path.splitext(os.path.basename(log))[0]
        for name, data in by_name.items():
            file = f"{stem}_{name}.csv"
            ours, other = (table(os.path.join(at, file)) for at in (directory, theirs))
            assert list(ours) == list(other), f"{file}: {list(ours)}, not {list(other)}"
            fields = {field.field_name: field for field in data.field_data}
            for column, texts in other.items():
                field = fields.get(column, fields.get(column + "[0]"))
                dtype = data.data[field.field_name].dtype
                if field.field_name != column:
                    dtype = np.dtype(str)
                pair = (values(it, field, dtype) for it in (ours[column], texts))
                compared += check(f"{file} {column}", *pair)
            messages += len(other["timestamp"])
    return len(by_name), messages, compared


def at(message, path):
    for step in path.split("."):
        name, index = re.fullmatch(r"(\w+?)(?:\[(\d+)\])?", step).groups()
        message = getattr(message, name)
        if index is not None:
            message = message[int(index)]
    return message


def compare_mcap(log, path):
    messages = compared = 0
    ulog = ULog(log)
    channels = {}
    with open(path, "rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        metadata = {it.name: it.metadata for it in reader.iter_metadata()}
        for _, channel, message, decoded in reader.iter_decoded_messages(log_time_order=False):
            channels.setdefault(channel.topic, []).append((message, decoded))
    assert sorted(channels) == sorted(f"/{it.name}_{it.multi_id}" for it in ulog.data_list)
    for data in ulog.data_list:
        topic = f"/{data.name}_{data.multi_id}"
        found = channels[topic]
        for field in (it for it in data.field_data if not is_padding(it.field_name)):
            theirs = data.data[field.field_name]
            # ROS has no capitals in the name of a field.
            ours = [at(decoded, field.field_name.lower()) for _, decoded in found]
            pair = (values(it, field, theirs.dtype) for it in (ours, theirs))
            compared += check(f"{topic} {field.field_name}", *pair)
        for (message, _), timestamp in zip(found, data.data["timestamp"], strict=True):
            # A message that nobody has stamped has the time of those around it.
            assert timestamp == 0 or message.log_time == int(timestamp) * 1000, topic
            assert message.publish_time == message.log_time
        messages += len(found)
    for name, value in ulog.msg_info_dict.items():
        value = value.hex() if isinstance(value, bytes) else str(value)
        assert metadata["info"][name] == value, name
    parameters = metadata.get("parameters", {})
    assert sorted(parameters) == sorted(ulog.initial_parameters)
    for name, value in ulog.initial_parameters.items():
        assert type(value)(parameters[name]) == np.float32(value), name
    changes = metadata.get("parameter_changes", {})
    assert len(changes) == len({(time, name) for time, name, _ in ulog.changed_parameters})
    return len(channels), messages, compared + len(parameters)


mode, log, exported = sys.argv[1:]
print(*{"csv": compare_csv, "mcap": compare_mcap}[mode](log, exported))
