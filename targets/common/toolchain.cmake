# What all targets share. A target's toolchain.cmake sets TARGET_COMPILER, TARGET_FLAGS
# and, where it is run, TARGET_QEMU, and includes this; its memory.ld says where flash
# and RAM are. Start-up, sections, semihosting and libm are picolibc's.
set(CMAKE_SYSTEM_NAME Generic)
set(CMAKE_C_COMPILER ${TARGET_COMPILER}gcc)
set(CMAKE_TRY_COMPILE_TARGET_TYPE STATIC_LIBRARY)

list(JOIN TARGET_FLAGS " " target_flags)
# the call graph is for the figures of the stack
set(CMAKE_C_FLAGS_INIT
	"${target_flags} --specs=picolibc.specs -ffunction-sections -fdata-sections -fcallgraph-info=su")
set(CMAKE_EXE_LINKER_FLAGS_INIT "-T ${TARGET_FOLDER}/memory.ld --crt0=semihost --oslib=semihost")
set(CMAKE_C_STANDARD_LIBRARIES_INIT "-lm")

if(TARGET_QEMU)
	set(CMAKE_CROSSCOMPILING_EMULATOR ${TARGET_QEMU} -nographic -monitor none -serial none
		-semihosting-config enable=on,target=native -kernel)
endif()
