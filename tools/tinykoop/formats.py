"""The formats that `tinykoop convert` reads, in the order in which a file is tried; each is one file in convert/."""

FORMATS = {
    "usd": "Crazyflie uSD deck, binary",
    "ulog": "PX4 ULog",
    "ardupilot": "ArduPilot dataflash, .BIN",
    "ros2": "ROS 2 bag: folder, .mcap or .db3",
    "crazyflie": "cfclient log-to-file: a CSV, or the folder of CSVs of one session",
    "betaflight": "Betaflight Blackbox: the CSV of blackbox_decode",
    "csv": "a CSV of your own, with --map",
}
