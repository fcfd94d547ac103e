//! The axes that a controller publishes.

use dbbd_model::findings;

findings! {
    /// A controller whose axes cannot be recorded, or whose axes are not all there.
    AxesFinding "The axes of the controller" {
        E2201 "the address of the axes is not valid",
        cause: "The address of the published axes has a scheme that is not known, an address without a port number, or an option that is not known.",
        cure: "Write `rsi://ADDR:PORT`, with `?answer=zero` where the controller waits for answers, or `rtde://HOST[:30004]`, with `?hz=1..500`.",
        asks: [PublishedAxes] {
            NoAddress { address: String } => "`{address}` is not an address of a controller's axes", help: "rsi://0.0.0.0:49152, rsi://0.0.0.0:49152?answer=zero, rtde://HOST or rtde://HOST:30004?hz=250";
        }
        E2202 "the address for the controller's axes cannot be used",
        cause: "Another program has the port (another dbbd?), or the address does not belong to this computer.",
        cure: "Choose another port number here and in the controller's configuration, or the address of this computer in the controller's network.",
        asks: [PublishedAxes] {
            NotListening { address: String, why: String } => "published axes at {address}: cannot listen there: {why}";
        }
        E2203 "the controller that publishes its axes cannot be reached",
        cause: "The controller is off or in another network, its address is another, or a firewall is between.",
        cure: "`ping` the controller; its RTDE port is 30004." {
            ControllerAway { address: String, why: String } => "{address}: {why}", help: "is the controller on, and is this its address?";
        }
        E2204 "the controller refuses to send its axes",
        cause: "It does not speak version 2 of RTDE, does not have `timestamp`, `actual_q` and `target_q`, or is not a controller.",
        cure: "Check address and port (30004). RTDE version 2 needs a CB3 controller of version 3.3 or later, or an e-Series." {
            Refused { address: String, step: &'static str } => "{address} refuses the {step}, or does not answer";
        }
        W2210 "no axes of the controller were recorded",
        cause: "The controller does not send to this address or is not in its RSI program, its configuration lacks DEF_AIPos, or a firewall is between.",
        cure: "Compare IP_NUMBER and PORT of the RSI Ethernet configuration with the address of the axes, and name DEF_AIPos and DEF_ASPos in its SEND. Lengths are used at the commanded axes.",
        asks: [PublishedAxes] {
            NothingCame { address: String } => "{address}: no axes came";
            NothingUnderstood { address: String, packets: u64 } => "{address}: none of {packets} packets holds measured axes with their time";
        }
        W2211 "packets of the controller's axes are missing",
        cause: "The network lost packets, or other programs send to the same address.",
        cure: "Up to 20 ms in a row are interpolated, a longer loss costs the lengths within it. Use a cable and a network of the cell's own." {
            PacketsLost { lost: u64, malformed: u64, packets: u64 } => "of the controller's axes {lost} packets were lost and {malformed} are not understood; {packets} came";
        }
        W2212 "the controller's clock restarted",
        cause: "The controller was restarted, or another one took its place.",
        cure: "The lengths across the restart are left out. Record again if the robot was changed." {
            ClockRestarted { restarts: u64 } => "the controller's clock restarted ({restarts} times)";
        }
        W2213 "answers to the controller came late",
        cause: "The controller counts answers that do not reach it within its cycle; after too many it stops the robot.",
        cure: "Set ONLYSEND to TRUE in the RSI Ethernet configuration and leave `?answer=zero` out: dbbd needs no answers." {
            AnswersLate { late_answers: u32 } => "the controller counts {late_answers} answers as late";
        }
    }
}
