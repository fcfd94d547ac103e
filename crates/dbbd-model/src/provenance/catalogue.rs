//! What artefacts were made from.

use crate::diagnostic::Names;
use crate::findings;

findings! {
    /// Artefacts that do not belong together, or whose chain is not known.
    ProvenanceFinding "Provenance" {
        E0104 "a file is of another kind",
        cause: "The file is one that dbbd reads or writes, but it is not of the kind that is needed here.",
        cure: "Give the file that the help names." {
            OtherKind { found: String, wanted: String, file: &'static str } => "is of the kind `{found}`, and one of the kind `{wanted}` is needed", help: "{file}";
        }
        E1801 "a program is corrected already",
        cause: "The program was corrected before, or its plan was made on an identified robot. A second correction moves every point by the correction once more.",
        cure: "Correct the original program; run a program of a plan on an identified robot as it is." {
            CorrectedBefore { source: String } => "the program is corrected already, by {source}",
                help: "correct the original program with the newest robot-identified.toml";
        }
        E1802 "inputs are of different robots",
        cause: "The serial numbers, or without them the names of the robots in two inputs differ.",
        cure: "Give the files of one robot. If it is the same one, give it the same `name` and `serial` in robot file and job." {
            OtherRobot { artefact: String, made_for: String, given: String } => "{artefact} was made for {made_for}, and {given} is given";
            OtherSerial { serial: String, first: String, of_first: String } => "is of the robot with serial number {serial}, {first} of that with {of_first}";
            OtherJobSerial { job: String, robot: String } => "the job is for serial number {job}, and the robot file has {robot}";
        }
        W1803 "the robot file was changed since",
        cause: "Two inputs name one robot, but its nominal file had another content when each of them was made.",
        cure: "Check what was changed. If it was the table or the tool, plan and measure again." {
            RobotChanged { artefact: String, made_for: String, given: String } => "{artefact} was made with {made_for}, and {given} is given: the robot file was changed";
        }
        W1804 "an input belongs to another calibration",
        cause: "It was planned or measured on an identified robot, and another robot-identified.toml is given: one that was made from it since, an older one, or one from other lengths. The poses were chosen for the first.",
        cure: "Give the robot-identified.toml that the plan was made on. If another one is in force, plan and measure again with it." {
            Outdated { artefact: String, used: String, newest: String } => "{artefact} was made on {used}; {newest} is newer";
            OtherCalibration { artefact: String, used: String, given: String } => "{artefact} was made on {used}, and {given} is given: that is another calibration";
        }
        W1805 "lengths are used twice",
        cause: "The same lengths are given twice, or the robot given was identified from them, or two results that are compared rest on them. Their information is then counted twice.",
        cure: "Give each file once, and check a robot with lengths that it was not identified from." {
            UsedBefore { lengths: String, robot: String } => "{robot} was identified from {lengths}";
            SameLengths { lengths: String, first: String } => "is made from {lengths}, as {first} is: a difference is not a change of the robot";
            GivenTwice { lengths: String } => "{lengths} is given twice";
        }
        W1840 "a robot file was changed after it was written",
        cause: "The hash in the last line of robot-identified.toml is that of another text. Its values are then not those that were identified.",
        cure: "Take the file as dbbd wrote it. If the change is meant, remove the last line, and you are then responsible for the values." {
            RobotEdited => "was changed since dbbd wrote it: its hash is of another text";
        }
        W1841 "a file is not the controller's $config.dat",
        cause: "Tools and bases of a KUKA controller are in $config.dat. Another file may have other values of the same names.",
        cure: "Give the controller's own $config.dat.",
        asks: [ControllerConfig] {
            NotConfig { begins: String } => "the file begins with `{begins}`, and $config.dat with DEFDAT $CONFIG";
        }
        W1843 "the calibration of a robot has warnings",
        cause: "The result with which robot-identified.toml was written has warnings. They apply to everything that is computed with the file.",
        cure: "`dbbd explain` explains each of the codes, report.html beside the file has their numbers. Resolve them and identify again." {
            RobotWithWarnings { robot: String, warnings: Names } => "`{robot}` was identified with {warnings}";
        }
        W1844 "an identity contradicts the job of the plan",
        cause: "The file of the identity states another robot, bar, certificate or temperature of the bar, or further base balls, than the job of the plan that is measured, or than the capture: a file of another run. The lengths were computed with what the job and the bar's sensor say.",
        cure: "Give the identity of this run. With another bar, plan again.",
        asks: [Identity] {
            OtherThanPlanned { key: String, planned: String, stated: String } => "{key} is stated as {stated}; the job has {planned}";
            SerialOfNoBall { ball: String, balls: usize } => "a serial number is stated of base ball {ball}, and there are {balls}";
        }
        W1845 "measurements of one result have different set-ups",
        cause: "The files beside two tables state different serial numbers of the bar or of a base ball: they were measured with other equipment, whose length or place differs.",
        cure: "Give tables of one set-up. Number another ball or bar again in the columns `centre` and `bar`; correct the identity if it is the same one." {
            OtherSetUp { key: String, known: String, stated: String } => "{key} is stated as {stated}; that of the lengths is {known}";
        }
        I1846 "the certificate of the bar is old",
        cause: "The bar was certified more than two years before the measurement. Wear of its seats and ageing change its length by more than the certificate states.",
        cure: "Have the bar certified again, or compare it with another one." {
            OldCertificate { date: String, years: f64 } => "the bar was certified on {date}, {years:.1} years before the measurement";
        }
        E1806 "lengths are of another result",
        cause: "lengths.csv beside robot-identified.toml is not the one that was written with it.",
        cure: "Keep the files of a result together, or identify again." {
            OtherLengths { lengths: String, expected: String } => "{lengths} is not what the robot was identified from ({expected})";
        }
        E1807 "what a file was made from cannot be read",
        cause: "A record of the artefacts that it was made from was changed or cut, so that a second correction or another robot would not be noticed.",
        cure: "Take the file as dbbd wrote it, or make it again." {
            Damaged { why: String } => "the record of what the file was made from is damaged: {why}";
        }
        E1808 "a result was changed after it was written",
        cause: "The hash at the end of result.json, check.json, circle.json or compare.json is that of another text. Its values are then not those that were computed.",
        cure: "Take the file as dbbd wrote it, or compute it again." {
            Edited => "was changed since dbbd wrote it: its hash is of another text";
        }
        W1809 "a table was changed after it was written",
        cause: "The file beside the table states what another content of it was made from. It is not known whether that applies to the present content.",
        cure: "Take the table as dbbd wrote it. Give a changed table another name: then its origin is not stated." {
            TableChanged { record: String } => "was changed since {record} was written; its robot, bar and date may be others";
        }
        I1850 "readings are simulated",
        cause: "They come from `dbbd simulate` or the port `sim`, whose virtual bar marks its stream. What is computed from them is of a simulated robot.",
        cure: "Nothing, to try dbbd. For a real robot, record its bar." {
            Simulated { simulated: String } => "{simulated} is simulated: the results are of no real robot";
        }
        W1851 "simulated readings are used together with others",
        cause: "One of the captures or tables is of the virtual bar of dbbd, and another one is not, or does not state it: a real robot is calibrated or checked with readings that are not of it.",
        cure: "Give the capture of the real bar. `dbbd info` shows which readings are simulated." {
            OriginsMixed { simulated: String, other: String } => "{simulated} is simulated, and {other} is not or does not state it";
        }
        W1852 "a calibration failed its last check",
        cause: "The newest check.json of this robot file, in its directory, above it or in a directory of these, found that the robot changed or exceeds its tolerance. The identified values are not those of the robot any more.",
        cure: "Identify the robot again, or have it repaired and check it again." {
            CheckFailed { robot: String } => "`{robot}` failed its last check: it is not to be used";
        }
        W1853 "the validity of a calibration is over",
        cause: "The day has passed until which the calibration, or its last check, holds.",
        cure: "Check the robot, or renew its calibration." {
            ValidityOver { robot: String, until: String } => "the validity of `{robot}` ended on {until}";
        }
        I1849 "a table that was not written by dbbd, or edited since, was moved aside",
        cause: "The table that was to be written was there, and nothing proves that it was unedited output of dbbd.",
        cure: "Nothing is lost: it is under the name that is stated. Name another file to keep both in place." {
            EditedMovedAside { table: String, aside: String } => "{table} was there and is now {aside}";
        }
    }
}

findings! {
    /// What is wrong in the statement of who measured what, where and with which bar.
    IdentityFinding "Identities" {
        E0680 "a text or a date of an identity cannot be used",
        cause: "A text of [identity], [bar] or [[centre]] is empty, too long or has control characters, a date does not exist or is impossible, a country is not an ISO code, or balls or temperatures are given twice.",
        cure: "Write texts in one line of at most 200 characters, and dates as \"2026-03-31\"." {
            EmptyText { key: String } => "{key} is empty";
            LongText { key: String, length: usize, most: usize } => "{key} has {length} characters, at most {most} are allowed";
            ControlInText { key: String, code: String } => "{key} holds the control character {code}: write one line of plain text";
            NotACountry { code: String } => "country = \"{code}\" must be two capital letters of ISO 3166-1, such as DE, or GB for the United Kingdom";
            CertifiedLater { date: String } => "certified_on = \"{date}\" is after the day of the measurement";
            InFuture { key: String, date: String } => "{key} = \"{date}\" is in the future, by the clock of this computer";
            NotABall { key: String } => "`{key}` is not a number of a base ball: they count from 1";
            SerialOfNoBall { key: String, balls: usize } => "a serial number of base ball {key}: the job has {balls}";
            TemperatureTwice { of: String } => "two temperatures are of {of}";
            TooEarly { key: String, date: String } => "{key} = \"{date}\" is before 1980";
            SerialTwice { serial: String } => "two base balls have the serial number {serial}";
            NotADate { key: String, date: String } => "{key} = \"{date}\" is not a date YYYY-MM-DD";
        }
        W0482 "the expansion of the bar is not given",
        cause: "The bar was warmer or colder than its certificate holds for, by more than the certificate's uncertainty of the length (without one by more than 20 um), and neither the job nor the record beside the table has expansion_per_k.",
        cure: "Give expansion_per_k (steel 11.5e-6, carbon fibre 1e-6) and temperature_c in [bar] of the job." {
            ExpansionNotGiven { mean_c: f64, longer_um: f64, u_um: f64 } => "the bar was at {mean_c:.1} degrees Celsius: of steel it was {longer_um:+.0} um longer than certified, and its length is known to {u_um} um";
        }
    }
}
