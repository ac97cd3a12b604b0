"""What a user of MAVSDK writes.

    mavsdk_station.py STORY PORT [ARGUMENT...]

It speaks to the bridge at a UDP port, asserts what it sees, and prints a line when
the story may go on.
"""

import json
import math
import sys
import threading
import time

from mavsdk import ComponentType, Configuration, Mavsdk
from mavsdk.plugins.action import Action
from mavsdk.plugins.mavlink_direct import MavlinkDirect, MavlinkMessage
from mavsdk.plugins.param import Param
from mavsdk.plugins.telemetry import Telemetry

PATIENCE = 60


def vehicle(port):
    """The vehicle behind a port, and what must live as long as it is used."""
    mavsdk = Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION))
    mavsdk.add_any_connection(f"udpout://127.0.0.1:{port}")
    system = mavsdk.first_autopilot(PATIENCE)
    assert system is not None, "no vehicle was discovered"
    return mavsdk, system


def until(what, is_so):
    """Waits until something is so."""
    deadline = time.monotonic() + PATIENCE
    while not is_so():
        assert time.monotonic() < deadline, what
        time.sleep(0.02)


def sees_and_commands(port):
    mavsdk, system = vehicle(port)
    assert system.get_system_id() == 1
    telemetry = Telemetry(system)
    until("attitude", lambda: not math.isnan(telemetry.attitude_euler().yaw_deg))
    until("position", lambda: abs(telemetry.position().latitude_deg - 47.397742) < 1e-4)
    until("GPS", lambda: telemetry.gps_info().num_satellites > 0)
    until("battery", lambda: telemetry.battery().voltage_v > 1)
    until("IMU", lambda: abs(telemetry.imu().acceleration_frd.down_m_s2 + 9.8) < 1)
    until("landed", lambda: telemetry.landed_state().name == "ON_GROUND")
    until("mode", lambda: telemetry.flight_mode().name != "UNKNOWN")
    until("health", lambda: telemetry.health().is_accelerometer_calibration_ok)
    telemetry.set_rate_attitude_quaternion(20.0)

    print("sees all", flush=True)

    action = Action(system)
    action.arm()
    until("armed", telemetry.armed)
    action.disarm()
    until("disarmed", lambda: not telemetry.armed())

    print("commands", flush=True)

    param = Param(system)
    assert param.get_param_int("SYS_AUTOSTART") == 4001
    param.set_param_float("MC_ROLL_P", 7.25)
    assert param.get_param_float("MC_ROLL_P") == 7.25
    print("parameters", flush=True)


def custom_message(port, xml):
    mavsdk, system = vehicle(port)
    direct = MavlinkDirect(system)
    # The include is MAVSDK's own: only what is ours is given.
    text = open(xml).read().replace("<include>common.xml</include>", "")
    direct.load_custom_xml(text)
    came, is_there = [], threading.Event()

    def take(message, _):
        came.append(json.loads(message.fields_json))
        is_there.set()

    direct.subscribe_message("CA_TRAJECTORY_MSG", take)
    fields = {
        "time_start_usec": 1_000_001,
        "time_stop_usec": 2_000_002,
        "coefficients": [k / 4 for k in range(28)],
        "seq_id": 77,
    }
    direct.send_message(MavlinkMessage("CA_TRAJECTORY_MSG", 255, 190, 0, 0, json.dumps(fields)))
    print("sent", flush=True)
    sys.stdin.readline()
    assert is_there.wait(PATIENCE), "it never came"
    seen = {name: came[0][name] for name in ["time_start_usec", "time_stop_usec", "seq_id"]}
    assert seen == {"time_start_usec": 5, "time_stop_usec": 6, "seq_id": 8}, came[0]
    assert came[0]["coefficients"] == [-k / 8 for k in range(28)], came[0]
    print("received", flush=True)


def reconnects(port):
    """Says when the vehicle is there, goes, and is there again."""
    mavsdk, system = vehicle(port)
    print("is there", flush=True)
    until("it goes", lambda: not system.is_connected())
    print("is gone", flush=True)
    until("it comes back", system.is_connected)
    print("is there again", flush=True)


STORIES = {story.__name__: story for story in [sees_and_commands, custom_message, reconnects]}
STORIES[sys.argv[1]](*sys.argv[2:])
