"""A foreign program of a story: it knows iceoryx2, and of us what
docs/joining-from-iceoryx2.md says.

It is for actor.rs what a program of another house is for one of ours: it does
one thing, and says so in lines; the story speaks to it by lines, too, and ends
it by the end of its input.
"""

import ctypes
import signal
import struct
import sys
import time

import iceoryx2 as iox2

# Longer than the story waits for a line: what comes earlier came by itself.
PATIENCE = iox2.Duration.from_secs(60)

PR_SET_PDEATHSIG = 1


class UorbHeader(ctypes.Structure):
    _fields_ = [
        ("generation", ctypes.c_uint32),
        ("publisher", ctypes.c_uint32),
        ("publish_time_us", ctypes.c_uint64),
    ]


class Stream:
    """A topic's stream, opened as a program opens it that has read one page."""

    def __init__(self, prefix, root, name):
        config = iox2.config.default()
        config.global_cfg.prefix = iox2.FileName.new(prefix)
        config.global_cfg.root_path = iox2.Path.new(root + "/")
        self.node = iox2.NodeBuilder.new().config(config).create(iox2.ServiceType.Ipc)
        self.name = iox2.ServiceName.new(name)
        self.service = (
            self.node.service_builder(self.name)
            .publish_subscribe(iox2.Slice[ctypes.c_uint8])
            .user_header(UorbHeader)
            .open()
        )

    def attributes(self):
        values = self.service.attributes.values
        return {a.key.to_string(): a.value.to_string() for a in values}

    def subscriber(self):
        return self.service.subscriber_builder().create()

    def listener(self):
        return self.node.service_builder(self.name).event().open().listener_builder().create()

    def publisher(self, size_bytes):
        return self.service.publisher_builder().initial_max_slice_len(size_bytes).create()


def main():
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    iox2.set_log_level(iox2.LogLevel.Error)
    mode, prefix, root, name, *arguments = sys.argv[1:]
    stream = Stream(prefix, root, name)
    modes = {"describe": describe, "follow": follow, "wait": wait, "hold": hold, "forge": forge}
    modes[mode](stream, *arguments)


def say(line):
    print(line, flush=True)


def describe(stream):
    """Says what a stream says of itself."""
    for key, value in sorted(stream.attributes().items()):
        say(f"{key} {value}")


def follow(stream, count):
    """Receives, and looks again after a fifth of a millisecond."""
    subscriber = stream.subscriber()
    receive(subscriber, int(count), lambda: time.sleep(0.0002))


def wait(stream, count):
    """Receives, and sleeps until it is notified."""
    listener = stream.listener()
    subscriber = stream.subscriber()

    # It may wake for nothing, where it has seen the notification already.
    receive(subscriber, int(count), lambda: listener.timed_wait(PATIENCE))


def receive(subscriber, count, rest):
    """Names each publisher that it hears of. Of `count` numbered messages it says
    how they came."""
    say("following")
    publisher = None
    tally = Tally()
    while True:
        sample = subscriber.receive()
        if sample is None:
            rest()
            continue
        header = sample.user_header().contents
        if header.publisher != publisher:
            publisher = header.publisher
            say(f"publisher {publisher}")
        number = tally.take(header, sample.payload().as_memory_view())
        sample.delete()
        if number == count:
            say(tally.line())
            tally = Tally()


class Tally:
    """What has become of the messages that have a number."""

    def __init__(self):
        self.generation = None
        self.received = self.lost = self.torn = 0
        self.ages_us = []

    def take(self, header, payload):
        """Counts a message. Returns its number, 0 if it has none."""
        message = ACCEL.unpack(payload)
        timestamp, number = message[0], message[2]
        now_us = time.monotonic_ns() // 1000
        whole = message[1:] == accel(number) and timestamp <= header.publish_time_us <= now_us
        self.torn += not whole
        # The first one of all has the generation before that of number 1.
        if number > 0:
            self.received += 1
            self.lost += (header.generation - self.generation - 1) % 2**32
            self.ages_us.append(now_us - header.publish_time_us)
        self.generation = header.generation
        return number

    def line(self):
        ages = sorted(self.ages_us)
        middle, most = ages[len(ages) // 2], ages[len(ages) * 99 // 100]
        print(
            f"age of {len(ages)} messages: median {middle} us, 99% {most} us, worst {ages[-1]} us",
            file=sys.stderr,
        )
        return f"received {self.received} lost {self.lost} torn {self.torn}"


# sensor_accel: timestamp, integral_dt, error_count, nine floats, the device's
# number, four raw values. The order is that of `uorb info`.
ACCEL = struct.Struct("<QQQ9fI4h")


def accel(number):
    """All after the timestamp of the message of this number, as actor.rs has it."""
    floats = (float((number * 31 + i * 7919) % 2**20) for i in range(9))
    raw = ((number * 3 + i * 101) % 2**15 for i in range(4))
    return (
        number * 0x9E3779B97F4A7C15 % 2**64,
        number,
        *floats,
        number * 2654435761 % 2**32,
        *raw,
    )


def hold(stream):
    """Borrows a message, and does not give it back."""
    subscriber = stream.subscriber()
    say("following")
    while (sample := subscriber.receive()) is None:
        time.sleep(0.0002)
    say("holds one")
    sys.stdin.read()
    del sample


def forge(stream, size_bytes):
    """Publishes what is none of its business. A line has the generation that it
    claims for the first message, who is to have published it, and how many."""
    size_bytes = int(size_bytes)
    publisher = stream.publisher(size_bytes)
    say("publishing")
    for line in sys.stdin:
        generation, peer, count = map(int, line.split())
        for i in range(count):
            # The last one is a byte short.
            length = size_bytes - (i == count - 1)
            sample = publisher.loan_slice_uninit(length)
            header = sample.user_header().contents
            header.generation = (generation + i) % 2**32
            header.publisher = peer
            header.publish_time_us = time.monotonic_ns() // 1000
            ctypes.memset(sample.payload().as_ptr(), 0xFF, length)
            sample.assume_init().send()
        say("sent")


if __name__ == "__main__":
    main()
