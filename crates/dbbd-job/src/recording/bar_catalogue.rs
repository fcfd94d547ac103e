//! First contact with a bar: which one it is, and how well it reads.

use dbbd_model::findings;

findings! {
    /// A bar that is not known, or that reads worse than it should.
    BarFinding "The bar" {
        W2100 "the device is not known",
        cause: "The bytes are not those of a built-in definition: another kind of device, another parameter (address, number of digits), or a rate that was not tried.",
        cure: "Compare the bytes with the device's manual; `dbbd protocols show dbb-cobs-1` prints a definition to begin with, which is then given as the protocol.",
        asks: [Protocol] {
            UnknownDevice { bytes: usize } => "unknown: no definition explains the {bytes} bytes that came";
        }
        W2102 "the device sends nothing",
        cause: "It is off or asleep, the cable or the port is the wrong one, or it waits for a command that no definition has.",
        cure: "Switch it on, press its send key, check cable and port; without listening only, the commands of each definition are tried.",
        asks: [ListenOnly] {
            SaysNothing { port: String } => "nothing came from {port}";
        }
        E2105 "too few readings for a check of the bar",
        cause: "The bar sent nothing, its readings are not valid, or the check was too short.",
        cure: "Mount the bar between two balls that do not move, within its stroke, and check for a minute." {
            FewReadings { readings: usize, needed_s: f64 } => "{readings} valid readings: a check needs them over at least {needed_s} s";
        }
        W2106 "the bar was not at rest",
        cause: "The fixture was touched, the bar is not seated, or the table shakes.",
        cure: "Seat the bar again, wait until it has the temperature of the room, and repeat the check." {
            NotAtRest { t_s: f64, off_um: f64 } => "the bar was not at rest: at {t_s:.1} s it was {off_um:.2} um off";
        }
        W2107 "the bar drifts",
        cause: "Bar or fixture is still warming up, or a joint of the fixture creeps.",
        cure: "Leave bar and fixture in the room for an hour and repeat the check; a plan with reference poses takes a slow drift out." {
            Drifts { drift_um_min: f64, sigma_um: f64 } => "the bar drifts by {drift_um_min:.2} um in a minute; the standard deviation of one length is {sigma_um:.2} um";
        }
        W2108 "the rate differs from that of the protocol",
        cause: "The bar is set to another rate, the line is too slow for it, or readings are lost.",
        cure: "Compare with the bar's settings and its baud rate; readings that are missing by their numbers are reported as W0223." {
            RateDiffers { rate_hz: f64, nominal_hz: f64 } => "{rate_hz:.1} readings per second; the protocol has {nominal_hz:.1}";
        }
        W2109 "the bar marks some of its readings as invalid",
        cause: "The bar is near an end of its stroke, its battery is low, or its sensor is dirty.",
        cure: "Mount the bar in the middle of its stroke; `dbbd export` shows the status of each reading." {
            Invalid { invalid: usize, samples: usize } => "{invalid} of {samples} readings are marked as not valid";
        }
    }
}
