#!/bin/sh
# Stages on the simulator: plan, measure, identify, and plan again with what was learned, until every pose is allowed.
# usage: run.sh [DIRECTORY] [SEED]; the program is $DBBD, or `dbbd` on the path.
set -eu
here=$(cd "$(dirname "$0")" && pwd)
dbbd=${DBBD:-dbbd}
out=${1:-stages-out}
seed=${2:-1}
mkdir -p "$out"
cd "$out"
lengths=
set --                                   # what the next plan knows: at first the maker's tolerance
for stage in 1 2 3 4 5 6; do
    rm -rf "stage$stage"
    mkdir "stage$stage"
    echo "== stage $stage"
    "$dbbd" plan "$here/../stages.toml" "$@" --out "stage$stage/plan"
    "$dbbd" krl "stage$stage/plan/plan.csv" --out "stage$stage/krl" --quiet
    # The robot executes it, and the bar is read meanwhile. The true robot is drawn from the tolerance by the seed.
    "$dbbd" simulate --program "stage$stage/krl/DBB_MAIN.src" --world "$here/world.toml" --tool 30,20,10 --seed "$seed" \
        --speed 0 --link bar --quiet > /dev/null &
    robot=$!
    until [ -e bar ]; do
        kill -0 "$robot" 2> /dev/null || exit 1
        sleep 0.1
    done
    "$dbbd" acquire --port bar --plan "stage$stage/plan/plan.csv" --out "stage$stage/run.dbbd" --quiet
    wait "$robot"                        # fails when a reading was out of the stroke
    "$dbbd" sync "stage$stage/run.dbbd" --out "stage$stage/observations.csv" --quiet
    # All lengths so far, to the same ball: the header once, every row with an index of its own.
    lengths="$lengths stage$stage/observations.csv"
    awk 'BEGIN { FS = OFS = "," } FNR == 1 && NR > 1 { next } NR > 1 { $1 = ++rows } { print }' $lengths \
        > "stage$stage/all.csv"
    # A table does not carry the bar's certificate: half of the job's length_u_mm.
    # Exit code 3 is a warning, which the report shows; few poses leave some.
    "$dbbd" identify "stage$stage/all.csv" --robot kr60ha --tool 30,20,10 --centres stage1/plan/centres.csv --prior datasheet \
        --bar-u 0.001 --out "stage$stage/result" --quiet || [ $? -eq 3 ]
    grep -q '"stage"' "stage$stage/plan/plan.json" || break
    set -- --robot "stage$stage/result/robot-identified.toml"
done
echo "after $stage stages: $out/stage$stage/result/report.html"
