#!/bin/sh
# The simulated cell: a robot that executes a program, and the bar on it. At a real cell the robot does that by itself.
# usage: cell.sh PROGRAM.src [TRUE-ROBOT.toml]; the bar's port is then ./bar, until the program has ended;
# what it says is in cell.log. It waits until the bar is read.
here=$(cd "$(dirname "$0")" && pwd)
rm -f bar
"${DBBD:-dbbd}" simulate --program "$1" --world "$here/world.toml" --tool 30,20,10 ${2:+--robot "$2"} --speed 0 --link bar --quiet > /dev/null 2> cell.log &
until [ -e bar ]; do
    kill -0 $! 2> /dev/null || exit 1
    sleep 0.1
done
