//! The simulator: its world, its virtual bar, and the commands that run it.

use dbbd_model::findings;

findings! {
    /// A simulation that cannot be run, or whose readings have a warning.
    SimulationFinding "The simulator" {
        E1601 "a number for the simulator is out of range",
        cause: "A number that is given is not one that the simulator can use.",
        cure: "The help of `dbbd simulate` has the range of each number.",
        asks: [Fault, PublishedAxes, Pace] {
            OptionOutOfRange { option: String, value: f64, low: f64, high: f64 } => "{option} {value} must be {low} to {high}";
            SeedWithoutSimulation => "a seed applies only to the simulated cell", help: "give the port sim";
            FaultNotANumber { name: String, value: String } => "fault {name}={value}: not a number";
            AxesWithoutPace => "publishing axes needs a pace: packets have the time of the host, and with the speed 0 the bar has none", help: "give the speed 1";
            UnknownFault { name: String, known: String } => "there is no fault `{name}`", help: "there are: {known}";
        }
        E1602 "the simulated world does not fit the program",
        cause: "WORLD.toml gives a ball twice or not at all, or lacks a value that the program's .dat does not have either.",
        cure: "The help of `dbbd simulate` lists the keys of the world.",
        asks: [World] {
            BallTwice { ball: u32 } => "[[centre]]: ball {ball} is given twice";
            BallWithoutPlace { ball: u32 } => "[[centre]]: ball {ball} needs either xyz_mm or taught_deg";
            UnknownBall { ball: u32 } => "the place of ball {ball} is neither in the program's .dat nor in the world",
                help: "give a [[centre]] with id and xyz_mm or taught_deg";
            UnknownKey { key: &'static str } => "the bar's {key} is neither in the program's .dat nor in the world", help: "give [bar] {key}";
        }
        E1603 "the simulated bar has no stroke",
        cause: "`stroke_mm` of WORLD.toml is not finite, or its ends are exchanged.",
        cure: "Give the lower end first." {
            Stroke { low_mm: f64, high_mm: f64 } => "[bar] stroke_mm = [{low_mm}, {high_mm}] must be [low, high]";
        }
        E1604 "the line of the virtual bar fails",
        cause: "The system has no pseudo-terminal left, the address to listen on is taken or none of this computer's, or the link cannot be made because a file that is not a link has its name.",
        cure: "Close programs that hold terminals; choose another link or address.",
        asks: [ListenAddress, Link] {
            Terminal { why: String } => "the virtual bar's line: {why}";
            NotToListenOn { address: String } => "{address}: not an address of the network", help: "tcp://ADDR:PORT or rfc2217://ADDR:PORT";
            NoLink { why: String } => "cannot be made: {why}";
        }
        E1606 "the simulated controller gets no answer over EthernetKRL",
        cause: "Nothing listens on the address for telegrams, or the answer is not one of dbbd.",
        cure: "Start `dbbd acquire` with the address for telegrams before the program.",
        asks: [Telegrams] {
            NotConnected { server: String, why: String } => "{server}: {why}", help: "start `dbbd acquire` with the address for telegrams before the program";
            NotExchanged { telegram: String, why: String } => "{telegram}: {why}";
            NotAnswered => "the connection ended without an answer";
            NotAcknowledged { answer: String } => "`{answer}` is not <Ack Id=\"..\"/>";
        }
        W1607 "readings at dwells were out of the bar's stroke",
        cause: "The true robot is farther off than the plan allowed for; a real bar would have left its cup.",
        cure: "Plan in stages, with less risk, or with a bar of more stroke." {
            OutOfStroke { readings: u64 } => "{readings} readings at dwells were out of the bar's stroke";
        }
        W1611 "the program reports to no server",
        cause: "A server for telegrams is given, and the program opens no channel: it was written with another synchronisation.",
        cure: "Write the program for EthernetKRL with the address of the server, or leave the address for telegrams out.",
        asks: [Telegrams, Synchronisation, TelegramServer] {
            NoTelegram { server: String } => "the program sent no telegram to {server}";
        }
        W1610 "the simulation was stopped by a signal",
        cause: "SIGTERM, SIGINT or another signal came before the program had ended, and nothing is saved.",
        cure: "Run it again, if the end of the program is needed." {
            Stopped { dwells: u32 } => "stopped by a signal after {dwells} dwells: nothing is saved";
        }
        E1608 "a command that was started for this one failed",
        cause: "A step of `dbbd demo` or of the simulated cell is a command of its own, and it ended with an error; its own message is above.",
        cure: "Run the step alone, as it is printed." {
            StepFailed { step: String, status: String } => "the step `dbbd {step}` failed ({status})";
            StepNotStarted { step: String, why: String } => "the step `dbbd {step}` could not be run: {why}";
            NoPort { status: String } => "the simulator gave no port ({status})", help: "run it alone to see why";
            SimulatorFailed { exit_code: i32 } => "the simulator failed (exit code {exit_code})";
            SimulatorGoesOn => "the simulator goes on although its bar is no longer read";
        }
    }
}
