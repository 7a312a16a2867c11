"""The library on microcontrollers: builds, runs on QEMU, sizes."""
