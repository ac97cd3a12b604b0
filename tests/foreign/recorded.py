"""Says what pyulog finds in logs, a line of JSON for each.

The messages of a topic instance are told by their number and by a digest of all
values of all fields, in order: two logs with the same line have the same messages.
"""

import contextlib
import hashlib
import io
import json
import sys

from pyulog import ULog


def read(path):
    # It prints what it thinks of a log, and has no other way to say it.
    words = io.StringIO()
    with contextlib.redirect_stdout(words):
        log = ULog(path)
    series = {}
    for data in log.data_list:
        digest = hashlib.sha256()
        for name in sorted(data.data):
            digest.update(name.encode())
            digest.update(data.data[name].tobytes())
        key = f"{data.name}/{data.multi_id}"
        assert key not in series, key
        series[key] = [len(data.data["timestamp"]), digest.hexdigest()]
    return {
        "series": series,
        "dropouts_ms": [dropout.duration for dropout in log.dropouts],
        "texts": [[chr(text.log_level), text.timestamp, text.message] for text in log.logged_messages],
        "infos": log.msg_info_dict,
        "parameters": log.initial_parameters,
        "defaults": log.get_default_parameters(0),
        "is_corrupt": log.file_corruption,
        "words": words.getvalue(),
    }


for path in sys.argv[1:]:
    print(json.dumps(read(path)))
