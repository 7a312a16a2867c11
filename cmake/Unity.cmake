# Provides the target `unity`: Unity of ThrowTheSwitch, the C test framework.
# Without a network, name its folder: -DFETCHCONTENT_SOURCE_DIR_UNITY=<folder with src/unity.c>.
include_guard(GLOBAL)
include(FetchContent)
if(POLICY CMP0135)
	cmake_policy(SET CMP0135 NEW) # CMake 3.24 warns otherwise
endif()

set(unity_store ${PROJECT_SOURCE_DIR}/build/unity) # of every build tree
file(LOCK ${unity_store} DIRECTORY GUARD FILE TIMEOUT 60) # build trees may be configured side by side
file(GLOB unity_archive ${unity_store}/*.tar.*)

# Downloads the archive into the store if there is none yet.
function(unity_download url sha256)
	if(unity_archive OR FETCHCONTENT_SOURCE_DIR_UNITY)
		return()
	endif()
	file(DOWNLOAD ${url} ${unity_store}/part INACTIVITY_TIMEOUT 5 STATUS status)
	file(SHA256 ${unity_store}/part found)
	if(NOT found STREQUAL sha256)
		message(STATUS "Unity: not from ${url}: ${status}, SHA-256 ${found}")
		return()
	endif()
	get_filename_component(name ${url} NAME)
	file(RENAME ${unity_store}/part ${unity_store}/${name})
	set(unity_archive ${unity_store}/${name} PARENT_SCOPE)
endfunction()

unity_download(https://github.com/ThrowTheSwitch/Unity/archive/refs/tags/v2.5.2.tar.gz
	3786de6c8f389be3894feae4f7d8680a02e70ed4dbcce36109c8f8646da2671a)
# where GitHub cannot be reached: Unity 2.5.1 in Debian's source package ntpsec
unity_download(http://deb.debian.org/debian/pool/main/n/ntpsec/ntpsec_1.2.2+dfsg1.orig.tar.xz
	53e527e3d04d551d41af2d359c2715c2de5f5bfa2a695d4ec1a811b3e9137f63)
if(NOT unity_archive AND NOT FETCHCONTENT_SOURCE_DIR_UNITY)
	message(FATAL_ERROR "The C tests need Unity, which cannot be downloaded. Unpack a release of "
		"https://github.com/ThrowTheSwitch/Unity and add -DFETCHCONTENT_SOURCE_DIR_UNITY=<its folder>.")
endif()

FetchContent_Declare(unity URL "${unity_archive}" SOURCE_SUBDIR none) # only one file of it is compiled
FetchContent_MakeAvailable(unity)
find_path(unity_folder unity.c PATHS ${unity_SOURCE_DIR} PATH_SUFFIXES src tests/unity
	REQUIRED NO_DEFAULT_PATH NO_CMAKE_FIND_ROOT_PATH)
add_library(unity STATIC ${unity_folder}/unity.c)
target_include_directories(unity SYSTEM PUBLIC ${unity_folder})
