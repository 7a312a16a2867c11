# Provides the target `unity`: Unity of ThrowTheSwitch, the C test framework.
#
# In this order: 1. -DUNITY_DIR=, 2. an installed package, 3. the pinned release
# from GitHub, 4. a copy inside a Debian source package. What is fetched is kept
# in build/unity of the source tree, for every build tree.

include_guard(GLOBAL)

set(UNITY_DIR "" CACHE PATH "Folder with unity.c, or with src/unity.c")

set(unity_version 2.5.2)
set(unity_url "https://github.com/ThrowTheSwitch/Unity/archive/refs/tags/v${unity_version}.tar.gz")
set(unity_sha256 3786de6c8f389be3894feae4f7d8680a02e70ed4dbcce36109c8f8646da2671a)
set(unity_store "${CMAKE_SOURCE_DIR}/build/unity")

# Sets `result` to the folder of unity.c in or under one of the folders, or to "".
function(unity_look result)
	foreach(folder IN LISTS ARGN)
		foreach(at IN ITEMS "" /src /tests/unity /tests/unity/src)
			if(EXISTS "${folder}${at}/unity.c" AND EXISTS "${folder}${at}/unity.h")
				set(${result} "${folder}${at}" PARENT_SCOPE)
				return()
			endif()
		endforeach()
	endforeach()
	set(${result} "" PARENT_SCOPE)
endfunction()

# Unpacks an archive and keeps the files of Unity that are in it.
function(unity_unpack archive)
	set(scratch "${unity_store}/unpacked")
	file(REMOVE_RECURSE "${scratch}")
	file(MAKE_DIRECTORY "${scratch}")
	execute_process(COMMAND "${CMAKE_COMMAND}" -E tar xf "${archive}"
		WORKING_DIRECTORY "${scratch}" RESULT_VARIABLE failed OUTPUT_QUIET ERROR_QUIET)
	file(GLOB tops LIST_DIRECTORIES true "${scratch}/*")
	unity_look(found "${scratch}" ${tops})
	if(found AND NOT failed)
		# cjson's copy includes ../examples/unity_config.h
		if(EXISTS "${found}/../examples/unity_config.h")
			file(COPY "${found}/../examples/unity_config.h" DESTINATION "${unity_store}/examples")
		endif()
		file(COPY "${found}/unity.h" "${found}/unity_internals.h" DESTINATION "${unity_store}/src")
		# last, since it is what a later run looks for
		file(COPY "${found}/unity.c" DESTINATION "${unity_store}/src")
	endif()
	file(REMOVE_RECURSE "${scratch}")
endfunction()

function(unity_from_github)
	set(archive "${unity_store}/release.tar.gz")
	message(STATUS "Unity: trying GitHub")
	# short, so that a machine without GitHub soon goes on
	file(DOWNLOAD "${unity_url}" "${archive}" TIMEOUT 8 INACTIVITY_TIMEOUT 5 STATUS status)
	list(GET status 0 failed)
	if(NOT failed)
		file(SHA256 "${archive}" sha256)
		if(sha256 STREQUAL unity_sha256)
			unity_unpack("${archive}")
		else()
			message(STATUS "Unity: not used, its SHA-256 is ${sha256}")
		endif()
	endif()
	file(REMOVE "${archive}")
endfunction()

# apt checks the signatures and sums. ntpsec carries Unity 2.5.1, cjson 2.4.3.
function(unity_from_debian package)
	find_program(UNITY_APT_GET apt-get)
	mark_as_advanced(UNITY_APT_GET)
	if(NOT UNITY_APT_GET)
		return()
	endif()
	message(STATUS "Unity: trying the source package ${package} of Debian")
	set(work "${unity_store}/apt")
	execute_process(COMMAND sh "${CMAKE_CURRENT_FUNCTION_LIST_DIR}/unity-from-debian.sh" ${package} "${work}"
		TIMEOUT 300 OUTPUT_FILE "${unity_store}/${package}.log" ERROR_FILE "${unity_store}/${package}.log")
	file(GLOB archives "${work}/download/${package}_*.orig.tar.*")
	list(FILTER archives EXCLUDE REGEX "\\.asc$")
	foreach(archive IN LISTS archives)
		unity_unpack("${archive}")
	endforeach()
endfunction()

if(UNITY_DIR)
	unity_look(unity_source "${UNITY_DIR}")
	if(NOT unity_source)
		message(FATAL_ERROR "UNITY_DIR=${UNITY_DIR} holds neither unity.c nor src/unity.c")
	endif()
else()
	find_package(unity CONFIG QUIET)
	if(TARGET unity::framework)
		add_library(unity INTERFACE)
		target_link_libraries(unity INTERFACE unity::framework)
		message(STATUS "Unity: installed package, ${unity_DIR}")
		return()
	endif()

	file(MAKE_DIRECTORY "${unity_store}")
	unity_look(unity_source "${unity_store}")
	if(NOT unity_source)
		unity_from_github()
		unity_look(unity_source "${unity_store}")
	endif()
	foreach(package IN ITEMS ntpsec cjson)
		if(NOT unity_source)
			unity_from_debian(${package})
			unity_look(unity_source "${unity_store}")
		endif()
	endforeach()
	file(REMOVE_RECURSE "${unity_store}/apt")
endif()

if(NOT unity_source)
	message(FATAL_ERROR
		"The C tests need Unity (ThrowTheSwitch), which was found in none of four ways:\n"
		"  1. -DUNITY_DIR=<folder with unity.c or src/unity.c>: not given\n"
		"  2. an installed CMake package `unity`: none in CMAKE_PREFIX_PATH\n"
		"  3. ${unity_url}: not reachable, or not the pinned file\n"
		"  4. apt-get source ntpsec or cjson: no apt-get, or no mirror with source packages; see "
		"${unity_store}/*.log\n"
		"Unpack a release of Unity anywhere and name it with the first.")
endif()

message(STATUS "Unity: ${unity_source}")
add_library(unity STATIC "${unity_source}/unity.c")
target_include_directories(unity SYSTEM PUBLIC "${unity_source}")
