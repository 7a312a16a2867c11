# Cortex-M0+: no FPU, so size only; QEMU has no such board with enough memory.
set(CMAKE_SYSTEM_PROCESSOR cortex-m0plus)
set(TARGET_COMPILER arm-none-eabi-)
set(TARGET_FLAGS -mcpu=cortex-m0plus -mthumb -mfloat-abi=soft)
set(TARGET_FOLDER ${CMAKE_CURRENT_LIST_DIR})
include(${CMAKE_CURRENT_LIST_DIR}/../common/toolchain.cmake)
