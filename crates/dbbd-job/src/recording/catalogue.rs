//! Captures and recorded runs.

use dbbd_model::findings;

findings! {
    /// A capture that cannot be written or read, or a recorded run that is not whole.
    RecordingFinding "Captures and runs" {
        E0401 "the capture exists already",
        cause: "A capture is never overwritten.",
        cure: "Give another name, or move the old capture.",
        asks: [Out] {
            CaptureExists => "the capture exists already", help: "choose another name";
        }
        E0402 "a capture cannot be made",
        cause: "The directory does not exist, or this user may not write there.",
        cure: "Make the directory, or check its rights." {
            CaptureNotMade { why: String } => "the capture cannot be made: {why}";
        }
        E0403 "writing a capture failed",
        cause: "The disk is full or fails, or a limit of the file's size is reached. Every whole record is kept.",
        cure: "Make room on the file system, check it, or raise the limit (`ulimit -f`), and begin a new run." {
            DiskFull { why: String, samples: u64, bytes: u64 } => "the capture ends here: {why} ({samples} samples, {bytes} bytes are kept)", help: "make room on its file system and begin a new run";
            FileTooLarge { why: String, samples: u64, bytes: u64 } => "the capture ends here: {why} ({samples} samples, {bytes} bytes are kept)", help: "raise the limit of a file's size (`ulimit -f`) and begin a new run";
            DiskFailed { why: String, samples: u64, bytes: u64 } => "the capture ends here: {why} ({samples} samples, {bytes} bytes are kept)", help: "check its file system and begin a new run";
        }
        E0404 "a record does not fit into a capture",
        cause: "An attached file is longer than 64 MiB, or an event holds a number that JSON cannot hold.",
        cure: "Attach a smaller file. Without one, report the message: it is a fault of dbbd." {
            RecordTooLong { bytes: usize } => "a record of {bytes} bytes is too long for a capture";
            EventNotWritten { why: String } => "an event cannot be written: {why}";
        }
        E0405 "a file is not a capture",
        cause: "The file is of another kind, or no whole record of the capture is left.",
        cure: "Name a capture: what `dbbd acquire` or `dbbd import` writes." {
            NoCapture => "is not a capture: there is no whole record in it", help: "a capture is what `dbbd acquire` writes";
            NothingLeft => "no whole record of the capture is left";
        }
        E0406 "a capture is of another version",
        cause: "Its format is that of another version of dbbd.",
        cure: "Read it with the version of dbbd that wrote it." {
            OtherFormat { format: u32, supported: u32 } => "is a capture of format {format}; this version reads format {supported}";
        }
        E0407 "a capture lacks what the command needs",
        cause: "It was recorded without a plan, or the bar sent no sample.",
        cure: "Name the plan that the robot drove; its plan.json is read from the same directory.",
        asks: [Plan] {
            NoPlan => "holds no plan", help: "name it, with its .json beside it";
            NoSample => "holds no sample: the bar sent nothing";
        }
        E0408 "logged axis angles are of another plan",
        cause: "The .dat was written for another plan than the run's.",
        cure: "Fetch the .dat of the program that ran from the controller after the run." {
            OtherPlansData { plan: String, run: String } => "was written for plan {plan}, and the run is of plan {run}", help: "give the .dat of the program that ran";
        }
        W0410 "a capture is damaged",
        cause: "A kill or a loss of power leaves a torn end. A damage in the middle means that the disk, a copy or another program changed bytes or took records out.",
        cure: "All records around a damage are read. `dbbd recover` writes a capture without damages; copy a file that was damaged on the way again." {
            StrangeRecord { offset: u64, bytes: u64, kind: u8 } => "byte {offset}: the content of a record of kind {kind} is not understood; {bytes} bytes are left out";
            WrongChecksum { offset: u64, bytes: u64, record: &'static str } => "byte {offset}: the checksum of a record ({record}) is wrong; {bytes} bytes are left out";
            TornRecord { offset: u64, bytes: u64, record: &'static str, record_bytes: usize } => "byte {offset}: the file ends inside a record of {record_bytes} bytes ({record}); {bytes} bytes are left out";
            TornHead { offset: u64, bytes: u64 } => "byte {offset}: the file ends inside the head of a record; {bytes} bytes are left out";
            WrongLength { offset: u64, bytes: u64, record: &'static str } => "byte {offset}: the length of a record ({record}) is wrong; {bytes} bytes are left out";
            DamagedHeader { offset: u64, bytes: u64 } => "byte {offset}: the file's header is damaged; {bytes} bytes are left out";
            NoRecord { offset: u64, bytes: u64 } => "byte {offset}: no record begins here; {bytes} bytes are left out";
            NoHeader => "the file's header is missing: what came before is lost";
            RecordsMissing { offset: u64, records: u32 } => "byte {offset}: {records} records before it are missing";
            RecordsRepeated { offset: u64, bytes: u64, records: u64 } => "byte {offset}: {records} records are there twice or out of order; {bytes} bytes are left out";
            OtherCount { ended: u64, samples: u64 } => "the run ended with {ended} samples, and {samples} are read";
            MoreDamages { damages: usize } => "{damages} more damages (`dbbd info` lists all as JSON)";
        }
        W0411 "a run is not whole",
        cause: "The recording was killed or lost its disk, or it was too slow for the bar.",
        cure: "What was recorded is used. Measure again where poses are missing that you need." {
            SamplesLost { samples: u64 } => "{samples} samples were lost on the way to the disk";
            CutOff => "the run was cut off: there is no record of its end";
        }
        W0412 "a capture was recorded with another plan",
        cause: "The plan that is given is not the one that is attached to the capture.",
        cure: "Leave the plan out to use the attached plan. With another plan than the one that was driven, lengths belong to other poses.",
        asks: [Plan] {
            OtherPlan { recorded: String, named: String } => "the capture was recorded with plan {recorded}, and plan {named} is named";
        }
        W0413 "axis angles are known of some poses only",
        cause: "The logged axis angles are not the commanded ones, and those of other poses were not given.",
        cure: "Give the .dat of every module.",
        asks: [LoggedAxes] {
            AxesIncomplete { worst_deg: f64, poses: usize } => "the logged axis angles are up to {worst_deg:.3} degrees from the commanded ones, and {poses} poses have none: give the .dat of every module";
        }
        W0480 "a .dat holds no logged axis angles",
        cause: "The .dat is as `dbbd krl` wrote it: it was not fetched from the controller after the run, or its module did not run.",
        cure: "Fetch the .dat from the controller after the run. Without it the commanded axis angles are used." {
            NoAxesLogged { data: String } => "{data} holds no axis angles of a run: the commanded ones are used";
        }
        W0481 "the temperatures of a run are not those of a bar",
        cause: "The sensor of the bar failed or is loose.",
        cure: "Lengths are corrected by these temperatures where the job gives expansion_per_k: leave that out, or correct [temperature] of the mapping." {
            TemperatureJumps { step_k: f64 } => "the bar's temperature changes by {step_k:.1} K from one reading to the next: is its sensor loose?";
        }
        W0414 "a telegram of the program is malformed",
        cause: "Something else than the program of this plan sends to the address for telegrams, or the channel file is another version's.",
        cure: "Load the modules and the channel file (DbbEki.xml) that `dbbd krl` wrote for this plan.",
        asks: [Telegrams] {
            TelegramNotUtf8 => "the telegram is not UTF-8 text";
            TelegramTagOpen => "a tag of the telegram has no end";
            TelegramNotQuoted { element: String, name: String } => "{element}/@{name} of the telegram is not quoted";
            TelegramLacks { element: String, name: String } => "the telegram has no {element}/@{name}";
            TelegramNotWhole { name: String, value: String } => "Pt/@{name} of the telegram is `{value}`, not a whole number";
            TelegramNotAngle { name: String, value: String } => "Ax/@{name} of the telegram is `{value}`, not an angle in degrees";
            TelegramPhase { phase: u32 } => "Pt/@Ph of the telegram is {phase}, not 1 or 2";
        }
        W0415 "the capture was removed or changed while it was recorded",
        cause: "Another program or person removed, renamed, replaced or changed the file, or removed its directory.",
        cure: "Evaluate the new file. Where another program cut the old one, keep both: the new one lacks what was recorded before, and `dbbd info` says how much. Keep other programs away from captures that are being written." {
            TakenAway { new: String, bytes: u64 } => "the capture was removed, renamed or replaced: recording goes on in {new}, with the {bytes} bytes that were written before";
            Resized { new: String, bytes: u64, found: u64 } => "another program changed the capture: it has {found} bytes, and {bytes} were written; recording goes on in {new}";
        }
        W0416 "the date of a run cannot be right",
        cause: "The clock of the computer that recorded it, or of this one, is wrong: the run is dated before 1980, in the future, or before the certificate of its bar.",
        cure: "Set the clock. State the day of the measurement in the identity (key `measured`).",
        asks: [Identity] {
            UnlikelyDate { why: String } => "by the clock of the computer that recorded the run: {why}";
        }
        W0417 "a run was not compared with its plan at its end",
        cause: "The run is longer than what fits into the memory that recording may take. It is recorded as a whole.",
        cure: "`dbbd sync RUN` compares it; it takes 20 bytes of memory for each sample." {
            TooLongToCompare { samples: u64, most: u64 } => "{samples} samples were recorded and are not compared with the plan: `dbbd sync` does it ({most} at most are compared at the end of a run)";
        }
        W0418 "received bytes were not recorded",
        cause: "Writing the capture failed, while the bar went on.",
        cure: "Make room on the file system and begin a new run: what came after the failure is not in the capture." {
            Refused { bytes: u64 } => "{bytes} bytes that were received are not in the capture";
        }
        I0420 "the controller was in its absolute-accuracy mode",
        cause: "The controller corrects its motions by a model of its own ($ABS_ACCUR), so its axes are not at the commanded angles.",
        cure: "Nothing is wrong while the logged axis angles of all modules are given (by file, or by EthernetKRL).",
        asks: [LoggedAxes] {
            AbsoluteAccuracy => "the controller corrects its motions by a model of its own ($ABS_ACCUR)";
        }
        I0421 "the temperature of the bar",
        cause: "The job gives the bar's expansion (expansion_per_k), so lengths are corrected where temperatures were recorded.",
        cure: "Nothing to do. A bar that does not send its temperature is not corrected." {
            TemperatureCorrected { mean_c: f64, correction_um: f64, length_mm: f64 } => "bar at {mean_c:.1} degrees Celsius: lengths are corrected by its certificate ({correction_um:+.1} um at {length_mm} mm)";
            TemperatureUnknown => "no temperature of the bar was recorded: lengths are not corrected for it";
        }
    }
}
