//! The bar on its line: ports, and what came over them.

use dbbd_model::findings;

findings! {
    /// A port that cannot be used, or a run whose data are not complete.
    PortFinding "The bar and its port" {
        E0201 "there is no such port",
        cause: "The bar is not plugged in, or its port has another name since it was plugged in again.",
        cure: "Plug the bar in; `dbbd ports` lists what is there. The name `by-id/..` stays the same." {
            NoPort { port: String } => "no port `{port}`", help: "plug the bar in; `dbbd ports` lists what is there";
        }
        E0202 "this user may not open the port",
        cause: "On Linux a serial port belongs to a group, and this user is not in it.",
        cure: "Add yourself to the group, as a rule `sudo usermod -aG dialout $USER`, and log in again." {
            PortDenied { port: String } => "port `{port}` may not be opened by this user", help: "add yourself to its group, as a rule `sudo usermod -aG dialout $USER`, and log in again";
        }
        E0203 "another program uses the port",
        cause: "The port is open in another program, perhaps another dbbd or a terminal program.",
        cure: "Close the other program; on Linux `fuser PORT` names it." {
            PortBusy { port: String } => "port `{port}` is in use by another program", help: "close the other program; on Linux `fuser {port}` names it";
        }
        E0204 "the port cannot be opened",
        cause: "The system refuses the port or one of its settings: a rate that the adapter cannot do, or no device behind the name.",
        cure: "Check [line] of the protocol and the adapter; try another port." {
            PortRefused { port: String, why: String } => "port `{port}` cannot be opened: {why}";
        }
        E0208 "the serial ports cannot be listed",
        cause: "The system refuses the list of its devices.",
        cure: "Check the rights of this user; in a container, pass the devices on." {
            NoPortList { why: String } => "the system cannot list its serial ports: {why}";
        }
        E0205 "the bar does not answer",
        cause: "The bar is off or asleep, another device is at the port, or the protocol or its rate is another.",
        cure: "Switch the bar on; `dbbd protocols list` names the protocols; give that of the bar.",
        asks: [Protocol] {
            BarSilent { port: String, bauds: String } => "the bar at `{port}` does not answer (tried at {bauds} baud)", help: "is it switched on, and is this its port and its protocol?";
        }
        E0206 "the port went away",
        cause: "The bar was unplugged or its adapter failed while a command was sent.",
        cure: "Plug it in again, with another cable or at another USB port if it repeats." {
            PortGone { port: String, why: String } => "port `{port}` is gone: {why}";
        }
        E0207 "the address for the program's telegrams cannot be used",
        cause: "Another program has the address (another dbbd?), or it does not belong to this computer.",
        cure: "Choose another port number, or the address of this computer in the controller's network.",
        asks: [Telegrams] {
            NotListening { address: String, why: String } => "EthernetKRL at {address}: cannot listen there: {why}", help: "another program may have the port (another dbbd?), or the address does not belong to this computer";
        }
        I0210 "the adapter delays bytes",
        cause: "Adapters of this kind collect bytes before they pass them on; the times of the host are less accurate.",
        cure: "Install the packaged udev rule `packaging/99-dbbd.rules`, and plug the adapter in again." {
            AdapterHoldsBack { device: String, hold_ms: u32 } => "{device} delays bytes for up to {hold_ms} ms, which makes times inaccurate", help: "as root: echo 1 > /sys/bus/usb-serial/devices/{device}/latency_timer, or for all adapters this udev rule:\n  ACTION==\"add\", SUBSYSTEM==\"usb-serial\", DRIVER==\"ftdi_sio\", ATTR{{latency_timer}}=\"1\"";
        }
        I0211 "others can send telegrams",
        cause: "The address for telegrams can be reached from the network, and telegrams are not signed.",
        cure: "Use a network of the cell's own.",
        asks: [Telegrams] {
            OpenToNetwork { address: String } => "{address} can be reached from the network, where anyone can send telegrams: use a network of the cell's own";
        }
        I0212 "there is no serial port",
        cause: "No serial device is plugged in, or its driver is not loaded.",
        cure: "Plug the bar in; on Linux `dmesg` shows what the system found." {
            NoPorts => "no serial port is plugged in";
        }
        E0230 "the address of the port is not valid",
        cause: "The port has a scheme that is not known, or an address without a host or a port number.",
        cure: "Write a device (`/dev/ttyUSB0`, `COM3`, `by-id/..`), `tcp://HOST:PORT`, `rfc2217://HOST:PORT` or `sim`.",
        asks: [Port] {
            NoAddress => "the port has no name";
            AddressScheme { scheme: String } => "no transport `{scheme}://`", help: "a port is a device, tcp://HOST:PORT, rfc2217://HOST:PORT or sim";
            AddressHost { address: String } => "`{address}`: the host is missing or not valid", help: "HOST:PORT, a number of IPv6 in brackets: [::1]:4001";
            AddressNumber { address: String } => "`{address}`: the port number is missing or not 0 to 65535", help: "HOST:PORT; the serial server's settings show the number of each of its lines";
        }
        E0231 "the serial server cannot be reached",
        cause: "The host is off or in another network, the name or port number is another, or a firewall is between.",
        cure: "`ping` the host; compare the port number with the settings of the serial server." {
            ServerAway { port: String, why: String } => "{port}: {why}", help: "is the serial server on, and is this its address and port number?";
        }
        E0232 "the serial server closes the connection at once",
        cause: "Another program uses the line (a serial server has one user a line), or the server may not open it.",
        cure: "Close the other program; the page or log of the serial server names the user of each line." {
            ServerCloses { port: String, said: String } => "{port} closes the connection at once: `{said}`", help: "another program may use the line";
        }
        E0233 "the server does not speak RFC 2217",
        cause: "The line is a raw one or one of plain telnet, or its server lets nobody set it.",
        cure: "Set rate and bits at the server and use `tcp://`, which reads raw lines and telnet; or allow RFC 2217 (ser2net: `telnet(rfc2217)`)." {
            NotRfc2217 { port: String } => "{port} does not speak RFC 2217", help: "set rate and bits at the server, and use tcp:// in place of rfc2217://: it reads raw lines and plain telnet";
        }
        E0234 "the serial server does not take a setting of the line",
        cause: "The server or the adapter behind it cannot do this rate, or its administrator has fixed it.",
        cure: "Set the bar and the protocol's [line] to what the server can do." {
            SettingRefused { port: String, setting: &'static str, asked: u32, got: String } => "{port}: {setting} {asked} was asked for, the server has {got}";
        }
        I0240 "the network makes times inaccurate",
        cause: "Bytes are stamped when they reach this computer; network and serial server delay them by a varying time.",
        cure: "Nothing to do for dwells. For a motion without stops use a bar with a clock of its own, or a serial port of this computer." {
            NetworkBlurs { port: String } => "{port}: the host's times are those of the arrival over the network; a bar with its own clock is not affected";
        }
        I0241 "the serial server speaks telnet",
        cause: "The server began with the negotiation of telnet, which doubles each byte 255 of the bar.",
        cure: "Nothing to do: dbbd speaks telnet on this line. `rfc2217://` would also set its rate; a raw line (ser2net: `tcp`, without `telnet`) has less to go wrong." {
            SpeaksTelnet { port: String } => "{port} speaks telnet: doubled bytes are undone; rate and bits are those of the server";
        }
        W0227 "the port's name is another device now",
        cause: "Adapters without a serial number of their own share one name `by-id/..`. The bar's adapter went away, and the name passed to another one.",
        cure: "Plug the bar's adapter into the same socket again. Name it by `by-path/..` (`dbbd ports`, `ls -l /dev/serial/by-path`), which stays with the socket." {
            OtherDevice { port: String, began: String, now: String } => "{port} is {now} now, and was {began} when the run began: it is not opened, for it may be another bar";
        }
        W0220 "the port stayed away",
        cause: "The bar was unplugged or switched off during the run, and did not come back in time.",
        cure: "What came before is kept. Plug the bar in, check its cable and supply, and repeat the run or identify with what is there.",
        asks: [GoneTime] {
            StayedAway { port: String, gone_s: f64 } => "{port} stayed away for {gone_s} s; what came before is kept";
        }
        W0221 "nothing was received, or nothing could be decoded",
        cause: "The bar is off or asleep, or the protocol or its baud rate is another.",
        cure: "`dbbd protocols show NAME` shows the bytes to compare with; `dbbd export RUN` writes the raw bytes.",
        asks: [Protocol] {
            NothingReceived => "nothing was received: is the bar switched on, and is this its port?";
            NotThisProtocol => "what was received is not this protocol: check the protocol and the bar's baud rate";
        }
        W0222 "the bar sent no length",
        cause: "The bar is outside of its stroke, or is not mounted.",
        cure: "Mount the bar between its balls and repeat the run." {
            NoLength { refusals: u64 } => "the bar sent no length, but {refusals} times that it has none: is it within its stroke?";
            FewValid { valid: u64, samples: u64 } => "the bar marked only {valid} of its {samples} readings as valid: is it within its stroke?";
        }
        W0223 "samples are missing",
        cause: "The line lost bytes, the bar's buffer overflowed, or the computer was too slow.",
        cure: "`dbbd sync` names the affected poses; a few samples outside of dwells do no harm. Try another cable or USB port, keep the cable from the drives' cables, and close other programs." {
            SamplesMissing { missing: u64, lost_bytes: u64, gaps: u64 } => "{missing} samples are missing and {lost_bytes} bytes were lost, in {gaps} gaps";
            Unanswered { requests: u64 } => "{requests} requests were not answered in time";
        }
        W0224 "the program's telegrams do not arrive or are refused",
        cause: "The channel file is not on the controller, its address is another, or the program is of another plan. A program whose telegram is refused halts.",
        cure: "Load the modules of this plan and their DbbEki.xml, written for EthernetKRL with this address.",
        asks: [Synchronisation, TelegramServer] {
            TelegramsRefused { telegrams: u64 } => "{telegrams} telegrams were refused, at which the program halts: is it this plan's program? `dbbd export` shows them among the events";
            NoTelegram => "no telegram came: was the program written for EthernetKRL with this address, and is its channel file on the controller?";
        }
        W0225 "the bar was silent",
        cause: "Its cable, its supply or its adapter failed, or it fell asleep.",
        cure: "`dbbd export` shows each silence among the gaps, `dbbd sync` names the affected poses. Check cable and supply, and measure again where poses are missing." {
            FellSilent { silent_s: f64, gaps: u64 } => "the bar was silent for {silent_s:.1} s in all ({gaps} gaps)";
        }
        W0226 "this computer stood still",
        cause: "The computer was suspended or too busy to read the line, for longer than its driver keeps bytes. The bar is not to blame.",
        cure: "`dbbd export` shows the time among the gaps, `dbbd sync` names the affected poses. Switch the saving of power off, close other programs, and measure again where poses are missing." {
            StoodStill { seconds: f64, gaps: u64 } => "this computer stood still for {seconds:.1} s in all ({gaps} gaps)";
        }
        W0228 "the unit of the gauge was changed",
        cause: "Readings came with another number of decimals than before, or than the gauge shows in the unit of the protocol: its key mm/inch was pressed.",
        cure: "Set the gauge to the unit of the protocol, or the parameter `unit` of the protocol to that of the gauge, and measure again: these readings were refused.",
        asks: [ProtocolParameter] {
            OtherUnit { readings: u64 } => "{readings} readings have another number of decimals than the protocol states or than those before, and were refused: the unit of the gauge was probably changed (mm/inch)";
        }
        W0280 "the bar is not seated",
        cause: "A ball lies on the rim of its cup or on a chip, so that the bar rocks at rest.",
        cure: "Take the bar off, wipe balls and cups, and mount it again until the page shows *stable*." {
            NotSeated { rocks_um: f64 } => "the bar is not seated: it rocks by {rocks_um:.0} micrometres";
        }
        W0281 "a ball creeps after mounting",
        cause: "A magnet still pulls its ball in, a screw or glue gives way, or the bar is warm from the hand.",
        cure: "Wait until the page shows *stable*; if it does not stop, tighten the cups and mount the bar again." {
            BallCreeps { rate_um_s: f64 } => "a ball creeps by {rate_um_s:.1} micrometres a second";
        }
        W0282 "a magnet slipped",
        cause: "A ball left its seat for a moment: the magnet is weak or dirty, or the robot accelerates too hard.",
        cure: "Clean the cups, use less speed, and repeat the run if it happens again." {
            MagnetSlipped { jump_um: f64 } => "a magnet slipped: the reading jumped by {jump_um:.0} micrometres and came back";
        }
        W0283 "the cable pulls at the bar",
        cause: "The bar's cable is too short, hangs free and swings, or is caught.",
        cure: "Lay the cable loosely along the arm with a loop at the bar, and fix it before the tool." {
            CablePulls { change_um: f64 } => "the cable pulls at the bar: the reading changes by {change_um:.0} micrometres at rest";
        }
        W0284 "a ball moved in its cup",
        cause: "A ball left its seat and came to rest in another place.",
        cure: "Clean balls and cups, mount the bar again, and repeat the run: lengths before and after do not belong together." {
            BallMoved { jump_um: f64 } => "a ball moved in its cup: the reading jumped by {jump_um:.0} micrometres and did not come back";
        }
        W0285 "the bar was out of its stroke",
        cause: "The robot measured where the bar is longer or shorter than its stroke, or the bar was off: a ball is not where it was taught, the tool ball or the robot is another one, or the program is of another plan.",
        cure: "Stop: the bar may leave its cups. Put the ball where the tool ball is at `taught_deg`, check tool ball and plan, and measure again; or plan again with a longer stroke." {
            OutOfStroke { dwells: f64 } => "the bar was out of its stroke, or off, when {dwells:.0} dwells began";
        }
    }
}
