# uORB between processes, for CMake.
#
#   find_package(uorb REQUIRED)
#   target_link_libraries(my_program uorb::uorb)
#
# uorb_add_messages compiles folders of .msg files; px4_add_module makes a program
# of a module that was written for PX4.

cmake_minimum_required(VERSION 3.16)

get_filename_component(UORB_PREFIX "${CMAKE_CURRENT_LIST_DIR}/../../.." ABSOLUTE)
set(UORB_COMMAND "${UORB_PREFIX}/bin/uorb")
set(UORB_MSG_DIR "${UORB_PREFIX}/share/uorb/msg")
set(UORB_PX4_MAIN "${UORB_PREFIX}/share/uorb/px4_main.c")

if(NOT TARGET uorb::uorb)
	add_library(uorb::uorb INTERFACE IMPORTED)
	set_target_properties(uorb::uorb PROPERTIES
		INTERFACE_INCLUDE_DIRECTORIES "${UORB_PREFIX}/include;${UORB_PREFIX}/include/uorb-px4"
		INTERFACE_LINK_LIBRARIES
			"${UORB_PREFIX}/lib/libuorb_px4.a;${UORB_PREFIX}/lib/libuorb_msgs.a;${UORB_PREFIX}/lib/libuorb.so"
	)
endif()

# uorb_add_messages(TARGET FOLDER...)
#
# Makes a library TARGET of the .msg files of these folders. What links it can
# include their headers. Name ${UORB_MSG_DIR} among the folders to have one list of
# all topics, the installed ones too; else the list has these alone.
function(uorb_add_messages target)
	if(NOT ARGN)
		message(FATAL_ERROR "uorb_add_messages(${target}): name a folder with .msg files")
	endif()
	set(folders)
	set(messages)
	foreach(folder ${ARGN})
		get_filename_component(folder "${folder}" ABSOLUTE)
		list(APPEND folders "${folder}")
		# A file that comes, goes or changes makes CMake come here again.
		file(GLOB found CONFIGURE_DEPENDS "${folder}/*.msg")
		list(APPEND messages ${found})
	endforeach()
	set_property(DIRECTORY APPEND PROPERTY CMAKE_CONFIGURE_DEPENDS ${messages})

	set(out "${CMAKE_CURRENT_BINARY_DIR}/${target}")
	execute_process(
		COMMAND "${UORB_COMMAND}" msg --out "${out}" --search "${UORB_MSG_DIR}" ${folders}
		RESULT_VARIABLE failed
	)
	if(failed)
		message(FATAL_ERROR "uorb_add_messages(${target}): the messages have errors")
	endif()
	file(GLOB sources "${out}/src/*.c")
	add_library(${target} STATIC ${sources})
	target_include_directories(${target} PUBLIC "${out}/include")
	target_link_libraries(${target} PUBLIC uorb::uorb)
	set_target_properties(${target} PROPERTIES POSITION_INDEPENDENT_CODE ON)
endfunction()

# px4_add_module(MODULE modules__rover MAIN rover SRCS rover.cpp [INCLUDES ..]
#                [COMPILE_FLAGS ..] [LINK_FLAGS ..] [DEPENDS ..])
#
# As PX4 has it, but that it makes a program, `rover`, which runs the function
# rover_main. DEPENDS takes targets; those that only PX4 has are left out. What else
# PX4 knows (STACK_MAIN, PRIORITY, MODULE_CONFIG, UNITY_BUILD ..) is not needed.
function(px4_add_module)
	cmake_parse_arguments(PX4 "EXTERNAL;DYNAMIC;UNITY_BUILD"
		"MODULE;MAIN;STACK;STACK_MAIN;STACK_MAX;PRIORITY"
		"SRCS;INCLUDES;COMPILE_FLAGS;LINK_FLAGS;DEPENDS;MODULE_CONFIG" ${ARGN})
	foreach(needed MODULE MAIN SRCS)
		if(NOT PX4_${needed})
			message(FATAL_ERROR "px4_add_module: ${needed} is missing")
		endif()
	endforeach()
	if(PX4_UNPARSED_ARGUMENTS)
		message(FATAL_ERROR "px4_add_module(${PX4_MODULE}): unknown: ${PX4_UNPARSED_ARGUMENTS}")
	endif()
	if(NOT CMAKE_C_COMPILER_LOADED)
		message(FATAL_ERROR "px4_add_module(${PX4_MODULE}): the project needs the language C, too")
	endif()

	# By itself: the module's own sources may use the name PX4_MAIN.
	add_library(${PX4_MODULE}_px4_main OBJECT "${UORB_PX4_MAIN}")
	target_compile_definitions(${PX4_MODULE}_px4_main PRIVATE PX4_MAIN=${PX4_MAIN})
	target_link_libraries(${PX4_MODULE}_px4_main PRIVATE uorb::uorb)

	add_executable(${PX4_MAIN} ${PX4_SRCS} $<TARGET_OBJECTS:${PX4_MODULE}_px4_main>)
	target_compile_definitions(${PX4_MAIN} PRIVATE MODULE_NAME="${PX4_MAIN}")
	target_compile_options(${PX4_MAIN} PRIVATE ${PX4_COMPILE_FLAGS})
	target_include_directories(${PX4_MAIN} PRIVATE "${CMAKE_CURRENT_SOURCE_DIR}" ${PX4_INCLUDES})
	foreach(depend ${PX4_DEPENDS})
		if(TARGET ${depend})
			get_target_property(type ${depend} TYPE)
			if(type MATCHES "LIBRARY")
				target_link_libraries(${PX4_MAIN} PRIVATE ${depend})
			else()
				add_dependencies(${PX4_MAIN} ${depend})
			endif()
		else()
			message(STATUS "px4_add_module(${PX4_MODULE}): ${depend} is left out, a target of PX4 alone")
		endif()
	endforeach()
	target_link_libraries(${PX4_MAIN} PRIVATE ${PX4_LINK_FLAGS} uorb::uorb)
endfunction()
