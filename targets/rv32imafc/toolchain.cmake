# RISC-V with a single-precision FPU, as in the ESP32-P4.
set(CMAKE_SYSTEM_PROCESSOR rv32)
set(TARGET_COMPILER riscv64-unknown-elf-)
set(TARGET_FLAGS -march=rv32imafc -mabi=ilp32f)
set(TARGET_QEMU qemu-system-riscv32 -M virt -bios none)
set(TARGET_FOLDER ${CMAKE_CURRENT_LIST_DIR})
include(${CMAKE_CURRENT_LIST_DIR}/../common/toolchain.cmake)
