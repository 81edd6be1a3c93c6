# Writes HEADER: version, commit, compiler. Run at each build, so that the commit is the one that is
# built; the file is touched only when its text changes. `cmake -DSOURCE=… -DHEADER=… … -P` this file.
cmake_minimum_required(VERSION 3.25)
set(commit "unknown")
find_program(GIT git)
if(GIT)
    # An empty prefix: SOURCE is the top of its repository, not a copy inside another one.
    execute_process(COMMAND ${GIT} rev-parse --show-prefix HEAD WORKING_DIRECTORY ${SOURCE}
                    OUTPUT_VARIABLE answer RESULT_VARIABLE failed ERROR_QUIET)
    if(NOT failed AND answer MATCHES "^\n([0-9a-f]+)\n$")
        set(commit ${CMAKE_MATCH_1})
        # Kept figures under results/ are no source: drawing one does not make the next run dirty.
        execute_process(COMMAND ${GIT} status --porcelain --untracked-files=no -- . :!results WORKING_DIRECTORY ${SOURCE}
                        OUTPUT_VARIABLE changes ERROR_QUIET)
        if(changes)
            string(APPEND commit "-dirty")
        endif()
    endif()
endif()
string(REPLACE "\"" "\\\"" FLAGS "${FLAGS}")
file(CONFIGURE OUTPUT ${HEADER} CONTENT "#pragma once
#define PELLUCID_VERSION \"@VERSION@\"
#define PELLUCID_COMMIT \"@commit@\"
#define PELLUCID_COMPILER \"@COMPILER@\"
#define PELLUCID_CXX_FLAGS \"@FLAGS@\"
#define PELLUCID_BUILD_TYPE \"@BUILD_TYPE@\"
" @ONLY)
