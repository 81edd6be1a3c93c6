#!/bin/bash
# The contract of ./check and ./reproduce, on a copy of them whose experiments are shell scripts and whose
# cmake and ctest do nothing. Prints each broken claim; exit 1 if there is any.
set -u
source_dir=$(dirname "$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")")
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
broken=0

root="$work/a clone"   # a space in the path has to do no harm
bin=$root/build/release/bin
mkdir -p "$bin" "$root"/{experiments,configs,tests,elsewhere,.ci} "$work/fake"
cp -r "$source_dir"/{check,reproduce,tools,analysis} "$root/"
cp "$source_dir/.ci/run" "$root/.ci/"
rm -f "$root"/analysis/[!cr]*.py   # keeps common.py and report.py
echo 'pass' >"$root/tests/some_test.py"
for tool in cmake ctest; do
    printf '#!/bin/sh\necho "100%% tests passed, 0 tests failed out of 1"\n' >"$work/fake/$tool"
done
chmod +x "$work"/fake/*
export PATH="$work/fake:$PATH" PELLUCID_SKIP_SETUP=1

add_experiment() {  # NAME EXIT_CODE PASSED: what it was asked lands in FOLDER/arguments
    echo "// Does $1 hold?" >"$root/experiments/$1.cpp"
    cat >"$bin/$1" <<SCRIPT
#!/bin/bash
arguments="\$*"
while [ "\$1" != --out ]; do shift; done
[ $2 -gt 1 ] && exit $2
mkdir -p "\$2"
echo "\$arguments" >"\$2/arguments"
echo '{"experiment": "$1", "preset": "quick", "checks": [{"name": "c", "value": 1, "relation": "<=", "limit": 2, "passed": $3}]}' >"\$2/summary.json"
exit $2
SCRIPT
    chmod +x "$bin/$1"
    echo "import pathlib, sys; pathlib.Path(sys.argv[1], 'figure.png').write_bytes(b'png')" >"$root/analysis/$1.py"
}

run() {  # CLAIM EXPECTED_CODE COMMAND…: output stays in $work/out and $work/err
    local claim=$1 expected=$2 code=0
    shift 2
    "$@" >"$work/out" 2>"$work/err" || code=$?
    [ "$code" = "$expected" ] || report "$claim: exit $code, expected $expected"
}

report() {
    echo "BROKEN: $1"
    sed 's/^/    /' "$work/out" "$work/err"
    broken=1
}

holds() {  # CLAIM COMMAND…
    local claim=$1
    shift
    "$@" >/dev/null 2>&1 || report "$claim"
}

one_line_on_stderr() { [ "$(wc -l <"$work/err")" = 1 ]; }

cd "$root/elsewhere" || exit 1

run "no experiments is no failure" 0 ../check
run "reproduce without experiments draws an empty report" 0 ../reproduce
holds "the empty report is there" test -s ../results/report/index.html

add_experiment good 0 true
for arguments in "nothing_of_the_kind" "--presett quick" "--preset fast" "--preset" "--seed -1" "--seed=" "--backend gpu" "--out="; do
    # shellcheck disable=SC2086  # words on purpose
    run "bad usage: $arguments" 2 ../reproduce $arguments
    holds "bad usage takes one line: $arguments" one_line_on_stderr
done
run "check refuses what it does not know" 2 ../check --fast

run "reproduce runs the named" 0 ../reproduce good --preset=quick --seed 7 --backend cpu
holds "options reach the experiment" grep -q -- '--preset quick --out results/good --backend cpu --seed 7' ../results/good/arguments
holds "figures reach the report" test -s ../results/report/good.figure.png
holds "the question is in the report" grep -q 'Does good hold?' ../results/report/index.html
run "--out is seen from where the user stands" 0 ../reproduce --out mine --preset quick
holds "--out holds results and report" test -s mine/good/summary.json -a -s mine/report/index.html
rm -rf ../results
run "--build-only runs nothing" 0 ../reproduce --build-only
holds "--build-only leaves no results" test ! -e ../results
run "check runs experiments and shows the tests' closing line" 0 ../.ci/run
holds "closing line" grep -q '100% tests passed' "$work/out"
holds "check leaves no results" test ! -e ../results

add_experiment bad 1 false
run "a failed check is remembered" 1 ../reproduce
holds "and named" grep -q 'checks failed in: bad' "$work/err"
holds "and what follows still runs" test -s ../results/good/figure.png
holds "and reported" grep -q 'FAIL' ../results/report/index.html
run "check fails with a failing experiment" 1 ../check
holds "check names the step" grep -q 'failed: quick bad' "$work/err"

add_experiment bad 3 true
run "a missing device stops with its code" 3 ../reproduce
add_experiment bad 0 true
echo 'raise SystemExit(1)' >../analysis/bad.py
run "a figure that cannot be drawn stops" 4 ../reproduce
mkdir "$work/without" && echo 'raise ImportError("none here")' >"$work/without/vtk.py"
printf '#!/bin/sh\n' >"$bin/render" && chmod +x "$bin/render"
run "without VTK there is nothing to be compared with" 3 env PYTHONPATH="$work/without" ../tools/speed.sh --vtk
holds "and one line says so" one_line_on_stderr
holds "which names the package" grep -q python3-vtk9 "$work/err"
printf '#!/bin/sh\nexit 1\n' >"$work/fake/cmake"
run "a build that fails stops reproduce" 4 ../reproduce
run "a build that fails stops check" 1 ../check

exit $broken
