"""What a user of pymavlink writes, and a comparison of what came with a flight log.

    mavlink_station.py STORY PORT [ARGUMENT...]

It speaks to the bridge at a UDP port, asserts what it sees, and prints a line when
the story may go on.
"""

import contextlib
import io
import os
import shutil
import struct
import sys
import tempfile
import time

os.environ["MAVLINK20"] = "1"
from pymavlink import mavutil
from pymavlink.generator import mavgen

PATIENCE = 60


class Station:
    """A ground station at the other end of a link."""

    def __init__(self, port):
        # It speaks first, from any port, and the bridge answers there.
        self.link = mavutil.mavlink_connection(f"udpout:127.0.0.1:{port}", source_system=255)
        self.hello()
        self.heartbeat = self.one("HEARTBEAT")
        self.vehicle = (self.heartbeat.get_srcSystem(), self.heartbeat.get_srcComponent())

    def hello(self):
        self.link.mav.heartbeat_send(6, 8, 0, 0, 0)

    def one(self, name, where=lambda message: True, seconds=PATIENCE):
        """The next message of a name, for which something is so."""
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline:
            message = self.link.recv_match(type=name, blocking=True, timeout=1)
            if message is not None and where(message):
                return message
        raise AssertionError(f"no {name} came in {seconds} s")

    def command(self, number, *parameters):
        """Sends a command; the result in its one acknowledgement."""
        parameters = list(parameters) + [0] * (7 - len(parameters))
        self.link.mav.command_long_send(*self.vehicle, number, 0, *parameters)
        return self.one("COMMAND_ACK", lambda ack: ack.command == number).result

    def rate(self, name, count):
        """Messages a second, by the times that their publisher wrote."""
        first = self.one(name).time_boot_ms
        for _ in range(count):
            last = self.one(name).time_boot_ms
        return count * 1e3 / (last - first)

    def comes_at(self, name, wanted):
        """Whether the rate is this one. A busy machine may disturb it, not five times."""
        measured = []
        for _ in range(5):
            measured.append(self.rate(name, max(10, int(3 * wanted))))
            if abs(measured[-1] / wanted - 1) < 0.05:
                return
        raise AssertionError(f"{name} does not come at {wanted} Hz: {measured}")


def sees_and_commands(port):
    """All that a ground station asks of a vehicle."""
    station = Station(port)
    heartbeat = station.heartbeat
    assert heartbeat.autopilot == 12 and heartbeat.type == 2, heartbeat
    assert station.vehicle == (1, 1), station.vehicle
    for name in [
        "SYS_STATUS", "ATTITUDE", "ATTITUDE_QUATERNION", "HIGHRES_IMU", "GPS_RAW_INT",
        "GLOBAL_POSITION_INT", "LOCAL_POSITION_NED", "ALTITUDE", "VFR_HUD", "BATTERY_STATUS",
        "EXTENDED_SYS_STATE", "HOME_POSITION", "SYSTEM_TIME",
    ]:
        station.one(name)

    print("sees all", flush=True)

    station.comes_at("ATTITUDE", 100)
    print("at their rates", flush=True)
    assert station.command(511, 30, 50_000) == 0
    station.comes_at("ATTITUDE", 20)
    assert station.command(510, 30) == 0
    assert station.link.messages["MESSAGE_INTERVAL"].interval_us == 50_000
    assert station.command(511, 30, -1) == 0
    assert station.command(512, 148) == 0
    # It comes before its acknowledgement, or soon after.
    if "AUTOPILOT_VERSION" not in station.link.messages:
        station.one("AUTOPILOT_VERSION")
    # What was on its way when it was stopped has come by now.
    while station.link.recv_match(blocking=False) is not None:
        pass
    ends = time.monotonic() + 1
    while time.monotonic() < ends:
        message = station.link.recv_match(blocking=True, timeout=0.1)
        assert message is None or message.get_type() != "ATTITUDE", "it was stopped"
    print("and at others", flush=True)

    assert station.command(400, 1) == 0
    armed = 128
    station.one("HEARTBEAT", lambda heartbeat: heartbeat.base_mode & armed)
    assert station.command(400, 0) == 0
    station.one("HEARTBEAT", lambda heartbeat: not heartbeat.base_mode & armed)
    assert station.command(31_000) == 3, "it is unsupported"
    print("commands", flush=True)

    station.link.mav.param_request_list_send(*station.vehicle)
    parameters = {}
    while len(parameters) < 2:
        value = station.one("PARAM_VALUE")
        assert value.param_count == 2, value
        parameters[value.param_id] = value
    assert abs(parameters["MC_ROLL_P"].param_value - 6.5) < 1e-6, parameters
    packed = struct.pack("<f", parameters["SYS_AUTOSTART"].param_value)
    assert struct.unpack("<i", packed) == (4001,), parameters
    station.link.mav.param_set_send(*station.vehicle, b"MC_ROLL_P", 7.25, 9)
    station.one("PARAM_VALUE", lambda value: value.param_id == "MC_ROLL_P")
    station.link.mav.param_request_read_send(*station.vehicle, b"MC_ROLL_P", -1)
    read = station.one("PARAM_VALUE", lambda value: value.param_id == "MC_ROLL_P")
    assert read.param_value == 7.25, read

    station.link.mav.mission_request_list_send(*station.vehicle)
    assert station.one("MISSION_COUNT").count == 0
    print("parameters and missions", flush=True)


def compares(port, log):
    """Collects until it is told to stop, and compares with a log of the same flight."""
    import select

    from pyulog import ULog

    station = Station(port)
    # Each message that is published.
    for message in [31, 105, 24, 147]:
        assert station.command(511, message, 1_000) == 0, message
    print("listens", flush=True)
    came = {}
    while not select.select([sys.stdin], [], [], 0)[0]:
        message = station.link.recv_match(blocking=True, timeout=0.2)
        if message is not None:
            came.setdefault(message.get_type(), []).append(message)
    sys.stdin.readline()
    print("heard enough", flush=True)
    sys.stdin.readline()

    def rows(topic, *fields):
        found = set()
        for data in ULog(log).data_list:
            if data.name == topic and all(field in data.data for field in fields):
                found |= set(zip(*(data.data[field].tolist() for field in fields)))
        return found

    def all_of(name, pick, known):
        values = [pick(message) for message in came.get(name, [])]
        assert not known or values, f"{name} never came"
        strange = [value for value in values if value not in known]
        assert not strange, f"{name}: {len(strange)} of {len(values)}, the first {strange[0]}"
        print(name, len(values) > 0, flush=True)

    attitudes = rows("vehicle_attitude", "q[0]", "q[1]", "q[2]", "q[3]")
    all_of("ATTITUDE_QUATERNION", lambda m: (m.q1, m.q2, m.q3, m.q4), attitudes)
    axes = ["gyro_rad", "accelerometer_m_s2"]
    imu = rows("sensor_combined", *(f"{axis}[{i}]" for axis in axes for i in range(3)))
    all_of("HIGHRES_IMU", lambda m: (m.xgyro, m.ygyro, m.zgyro, m.xacc, m.yacc, m.zacc), imu)
    places = rows("vehicle_gps_position", "lat", "lon", "alt")
    names = ["latitude_deg", "longitude_deg", "altitude_msl_m"]
    for lat, lon, alt in rows("vehicle_gps_position", *names):
        places.add((round(lat * 1e7), round(lon * 1e7), round(alt * 1e3)))
    all_of("GPS_RAW_INT", lambda m: (m.lat, m.lon, m.alt), places)
    voltages = {round(v * 1000) for (v,) in rows("battery_status", "voltage_v")}
    all_of("BATTERY_STATUS", lambda m: m.voltages[0], voltages)


def custom_message(port, xml):
    """The message of our own, out and in, with pymavlink as a user builds it."""
    definitions = tempfile.mkdtemp()
    try:
        # Beside ours lies pymavlink's own common.xml and what that includes.
        own = os.path.join(os.path.dirname(mavutil.__file__), "dialects", "v20")
        for name in os.listdir(own):
            if name.endswith(".xml"):
                shutil.copy(os.path.join(own, name), definitions)
        shutil.copy(xml, os.path.join(definitions, "uorb.xml"))
        options = mavgen.Opts(
            output=os.path.join(definitions, "uorb"), wire_protocol="2.0", language="Python3",
            validate=False,
        )
        with contextlib.redirect_stdout(io.StringIO()):
            mavgen.mavgen(options, [os.path.join(definitions, "uorb.xml")])
        sys.path.insert(0, definitions)
        import uorb

        mavutil.mavlink = uorb
        station = Station(port)
        station.link.mav.ca_trajectory_msg_send(
            1_000_001, 2_000_002, [k / 4 for k in range(28)], 77
        )
        print("sent", flush=True)
        sys.stdin.readline()
        message = station.one("CA_TRAJECTORY_MSG")
        seen = (message.time_start_usec, message.time_stop_usec, message.seq_id)
        assert seen == (5, 6, 8), message
        assert list(message.coefficients) == [-k / 8 for k in range(28)], message
        print("received", flush=True)
    finally:
        shutil.rmtree(definitions)


def two_vehicles(first, second):
    """Two systems on one machine, seen by one program each on its own link."""
    for number, port in enumerate([first, second]):
        station = Station(port)
        assert station.vehicle == (number + 1, 1), station.vehicle
        for _ in range(5):
            message = station.link.recv_match(blocking=True, timeout=PATIENCE)
            assert message.get_srcSystem() == number + 1, message
    print("each is itself", flush=True)


STORIES = {
    story.__name__: story for story in [sees_and_commands, compares, custom_message, two_vehicles]
}
STORIES[sys.argv[1]](*sys.argv[2:])
