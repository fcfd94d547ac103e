//! The command line.

use dbbd_model::findings;

findings! {
    /// Arguments that cannot be followed.
    CliFinding "The command line" {
        E0001 "a code is not in the catalogue",
        cause: "The code is mistyped, or it is of another version of dbbd.",
        cure: "`dbbd explain` without a code lists all of them." {
            UnknownCode { code: String } => "there is no code {code}";
        }
        E0003 "an option's value is not valid",
        cause: "The value of an option on the command line is not of its type or out of its range (exit code 2).",
        cure: "`dbbd VERB --help` says what the option takes, with the unit." {
            NotPositive => "a positive number is needed";
            NotFine { most_mm: f64 } => "a positive number of at most {most_mm} mm is needed: is it in um?";
            Outside { least: f64, most: f64, unit: &'static str } => "a number from {least} to {most} {unit} is needed";
            NotAnExpansion => "an expansion by 1 K is some 0.00001 of the length (steel 11.5e-6, carbon fibre 1e-6)";
            NotACertifiedTemperature { least: f64, most: f64 } => "lengths are certified at {least} to {most} degrees Celsius";
            NotSeconds => "a number of seconds, 0 or more, is needed";
            NotNameAndValue => "must be NAME=VALUE";
            NotARisk => "a probability between 0 and 0.5 is needed";
        }
    }
}
