#!/usr/bin/env bash
# The Windows build under wine: plan, krl, identify (the numbers of Linux to 1e-12), acquire from tcp://, Ctrl-C and a kill during a run,
# a result that another program has open, reserved names, long paths, CR LF, serve, demo.
# Usage: tests/windows.sh [LINUX-BINARY]   (default target/release/dbbd). Fails where a tool is missing.
set -euo pipefail
cd "$(dirname "$0")/.."
target=x86_64-pc-windows-gnu
for needed in x86_64-w64-mingw32-gcc wine python3; do
    command -v "$needed" >/dev/null || { echo "$needed is not installed"; exit 1; }
done
${CARGO:-cargo} build --release --locked --target $target --bin dbbd
linux=$(realpath "${1:-target/release/dbbd}")

# A drive C: of its own. Without Z: no path of this system passes.
work=$(mktemp -d)
export WINEPREFIX=$work/prefix WINEDEBUG=-all WINEDLLOVERRIDES="mscoree,mshtml="
wine wineboot -i >/dev/null 2>&1
trap 'kill $(jobs -p) 2>/dev/null; wineserver -k; rm -rf "$work"' EXIT
if ! [ -e "$WINEPREFIX/drive_c/windows/system32/bcryptprimitives.dll" ]; then
    # wine 8 lacks the library from which the standard library draws its seeds.
    cat > "$work/prng.c" <<'C'
#include <windows.h>
BOOLEAN NTAPI SystemFunction036(PVOID, ULONG);
__declspec(dllexport) BOOL WINAPI ProcessPrng(PBYTE data, SIZE_T size) { return SystemFunction036(data, (ULONG)size); }
C
    x86_64-w64-mingw32-gcc -shared -o "$WINEPREFIX/drive_c/windows/system32/bcryptprimitives.dll" "$work/prng.c" -ladvapi32
fi
rm -f "$WINEPREFIX/dosdevices/z:"
cell=$WINEPREFIX/drive_c/cell
mkdir "$cell"
cp -r target/$target/release/dbbd.exe examples/circles.toml examples/paper "$cell/"
cd "$cell"
# Output goes to files: wine holds pipes open.
dbbd() { wine 'C:\cell\dbbd.exe' "$@" >"$work/out" 2>"$work/err" </dev/null || { code=$?; [ $code = 3 ] || { cat "$work/err"; echo "FAILED ($code): dbbd $*"; exit 1; }; }; }
step() { echo "$(date +%T) $*"; }

step "plan, krl"
dbbd plan circles.toml --out plan
dbbd krl 'plan\plan.csv' --out krl
grep -q "DEF DBB_MAIN" krl/DBB_MAIN.src

step "demo"
dbbd demo --out demo

step "identify the paper's experiment, against Linux"
estimate=alpha1-5,a1-5,d4-6
dbbd identify 'paper\observations.csv' --robot kr60ha --tool 30,20,10 --centres 'paper\centres.csv' --estimate $estimate --out windows
"$linux" identify paper/observations.csv --robot kr60ha --tool 30,20,10 --centres paper/centres.csv --estimate $estimate --out linux >/dev/null 2>&1 || [ $? = 3 ]
python3 - <<'PY'
import json
here, there = (json.load(open(f"{name}/result.json"))["parameters"] for name in ("linux", "windows"))
assert [one["name"] for one in here] == [one["name"] for one in there]
off = max(abs(a["identified"] - b["identified"]) for a, b in zip(here, there))
print(f"         largest difference of {len(here)} parameters: {off:.1e} rad or mm")
assert off <= 1e-12, off
PY

step "acquire over tcp:// from a simulator of Linux"
"$linux" simulate --program demo/krl/DBB_MAIN.src --robot demo/truth.toml --world demo/world.toml --speed 0 --listen tcp://127.0.0.1:0 >"$work/port" 2>/dev/null &
until [ -s "$work/port" ]; do sleep 0.1; done
dbbd acquire --port "$(head -1 "$work/port")" --plan 'demo\plan\plan.csv' --out tcp.dbbd
dbbd sync tcp.dbbd --out tcp.csv
[ "$(wc -l < tcp.csv)" -gt 100 ]

step "simulate on Windows, acquire over rfc2217:// on Linux"
wine 'C:\cell\dbbd.exe' simulate --program 'demo\krl\DBB_MAIN.src' --robot 'demo\truth.toml' --world 'demo\world.toml' --speed 0 --listen rfc2217://127.0.0.1:0 >"$work/port2" 2>/dev/null </dev/null &
until [ -s "$work/port2" ]; do sleep 0.1; done
"$linux" acquire --port "$(head -1 "$work/port2" | tr -d '\r')" --plan demo/plan/plan.csv --out rfc2217.dbbd 2>/dev/null
cmp <("$linux" sync tcp.dbbd --out a.csv >/dev/null; cut -d, -f1-8 a.csv) <("$linux" sync rfc2217.dbbd --out b.csv >/dev/null; cut -d, -f1-8 b.csv)

# The simulated bar of a run that goes on, and what a capture of it says of its end.
begin() { : >"$work/slow"; "$linux" simulate --program demo/krl/DBB_MAIN.src --robot demo/truth.toml --world demo/world.toml --speed 1 --listen tcp://127.0.0.1:0 >"$work/slow" 2>/dev/null & until [ -s "$work/slow" ]; do sleep 0.1; done; bar=$(head -1 "$work/slow"); }
ended() { { "$linux" info "$1" --json 2>/dev/null || true; } | python3 -c 'import json, sys; one = json.load(sys.stdin); print(one["ended"], one["samples"] > 0)'; }

step "Ctrl-C in the terminal of a run"
begin
python3 - "$bar" <<'PY'
import os, pty, select, sys, time
child, terminal = pty.fork()
if child == 0:
    os.execvp("wine", ["wine", r"C:\cell\dbbd.exe", "acquire", "--port", sys.argv[1], "--plan", r"demo\plan\plan.csv", "--out", "stopped.dbbd"])
began, pressed = time.time(), False
while time.time() - began < 60:
    if select.select([terminal], [], [], 0.1)[0]:
        try:
            if not os.read(terminal, 4096):
                break
        except OSError:
            break
    if not pressed and time.time() - began > 6:
        pressed = os.write(terminal, b"\x03") == 1
else:
    sys.exit("the run went on after Ctrl-C")
assert pressed, "the run ended before the key"
assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 3
PY
[ "$(ended stopped.dbbd)" = "stopped True" ]

step "a run that is killed"
begin
wine 'C:\cell\dbbd.exe' acquire --port "$bar" --plan 'demo\plan\plan.csv' --out killed.dbbd >/dev/null 2>&1 </dev/null &
sleep 6
pkill -9 -f 'dbbd.exe.acquire.*killed.dbbd'
[ "$(ended killed.dbbd)" = "None True" ]
dbbd recover killed.dbbd --out recovered.dbbd

step "a result that another program has open, reserved names, a long path, lines that end with CR LF"
refused() { wine 'C:\cell\dbbd.exe' "$@" >"$work/out" 2>"$work/err" </dev/null && { echo "NOT REFUSED: dbbd $*"; exit 1; }; grep -q '^error\[E' "$work/err" || { cat "$work/err"; exit 1; }; }
identify=(identify 'paper\observations.csv' --robot kr60ha --tool 30,20,10 --centres 'paper\centres.csv' --estimate $estimate)
others() { find windows -type f ! -name result.json | sort | xargs sha256sum; }
before=$(others)
wine cmd /c 'ping -n 8 127.0.0.1 >windows\result.json' >/dev/null 2>&1 </dev/null &
sleep 2
refused identify 'paper\observations.csv' --robot kr60ha --tool 30,20,10 --centres 'paper\centres.csv' --estimate a1-3 --out windows
[ "$before" = "$(others)" ]
wait $!
for name in NUL con.csv aux; do refused "${identify[@]}" --out "$name"; done
long=$(printf 'l%.0s' $(seq 120))
dbbd "${identify[@]}" --out "$long\\$long\\$long"
cmp "$long/$long/$long/parameters.csv" linux/parameters.csv
sed 's/$/\r/' paper/observations.csv >'paper/crlf.csv'
dbbd identify 'paper\crlf.csv' --robot kr60ha --tool 30,20,10 --centres 'paper\centres.csv' --estimate $estimate --out crlf
cmp crlf/parameters.csv linux/parameters.csv

step "serve, asked from outside"
port=$(python3 -c 'import socket; s = socket.create_server(("127.0.0.1", 0)); print(s.getsockname()[1])')
printf 'address = "127.0.0.1:%s"\n[device]\nport = "COM5"\n' "$port" > dbbd.toml
wine 'C:\cell\dbbd.exe' serve --config dbbd.toml >/dev/null 2>"$work/serve" </dev/null &
for _ in $(seq 100); do curl -sf "http://127.0.0.1:$port/api/v1/status" >"$work/status" && break; sleep 0.1; done
grep -q '"no_device"' "$work/status"
curl -sf "http://127.0.0.1:$port/" >"$work/page"
grep -qi "<!doctype html>" "$work/page"
step "done"
