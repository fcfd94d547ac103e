//! Traces that other software recorded.

use dbbd_model::findings;

findings! {
    /// A trace or its mapping that cannot be read.
    ImportFinding "Import of traces" {
        E1101 "a mapping has an invalid value",
        cause: "A key of the mapping has a value that is not possible.",
        cure: "examples/mapping.toml explains every key." {
            Delimiter => "must be one character, or \"space\"";
            Decimal => "must be \".\" or \",\"";
            DecimalIsDelimiter => "is the same as the delimiter";
            Rate => "must be a positive number";
            RateAndColumn => "rate_hz is in place of a column of times: give one of them";
            UnitOfText => "is a unit of numbers, and `format` and `date_column` are for text";
            TimeFormatItem { item: String } => "`{item}` is not a part of a time", help: "%Y %y %m %b %d, %H, or %I with %p, %M %S %f, %z; %s for seconds since 1970; %% for a percent sign";
            TimeFormatLacks { what: &'static str } => "lacks {what}";
            Threshold => "must be a finite number";
            NoHeader { column: String } => "has no header by its mapping, so the column `{column}` must be a number from 1";
        }
        E1103 "a field of a trace cannot be read",
        cause: "The field holds another format than the mapping says, or than the rows before.",
        cure: "Look at the line that is named, and correct the mapping: [time] unit or format, the columns, [strobe] threshold." {
            NotAFlag { field: String } => "`{field}` must be 0 or 1, or a word as on, high, true", help: "the column of a voltage needs a `threshold` in the mapping";
            NotADate { field: String } => "`{field}` is not a date and time as the rows before, or as 2026-11-21T14:02:11.123, 21.11.2026 14:02:11,123, 11/21/2026 2:02:11 PM", help: "in a mapping [time] format says how it is written, as in format = \"%d/%m/%y %H:%M:%S.%f\"";
            NotOfFormat { field: String } => "`{field}` is not as [time] format of the mapping says";
            DayOrMonth { field: String } => "`{field}`: is the day first or the month? No day above 12 shows it", help: "say it in a mapping: [time] format = \"%d/%m/%Y %H:%M:%S.%f\", or \"%m/%d/%Y ..\"; %I and %p for AM and PM";
        }
        E1104 "the time of a trace goes back",
        cause: "A counter began again from 0, lines are not in order, or the column is not a time.",
        cure: "Unwrap the counter, sort the lines, or correct [time] in the mapping." {
            TimeGoesBack => "the time goes back", help: "a counter that begins again must be unwrapped; or is the unit wrong?";
        }
        E1105 "a length of a trace is not one of this bar",
        cause: "The unit is another, or a reading was taken for a distance or the other way round.",
        cure: "Correct [length] unit and kind in the mapping." {
            NoLengthOfBar { value_mm: f64, bar_mm: f64 } => "{value_mm} mm is not a length of a bar of {bar_mm} mm", help: "is the unit right, and is it the distance between the ball centres? ([length] unit, kind)";
            NoReadingOfBar { value_mm: f64, bar_mm: f64 } => "{value_mm} mm is not a reading of a bar of {bar_mm} mm", help: "is the unit right, and is it the reading? ([length] unit, kind)";
        }
        E1106 "a trace holds no reading",
        cause: "The file is empty or holds only a header, or skip_lines or comment of the mapping leave out every line.",
        cure: "Check the file and [file] skip_lines and comment in the mapping." {
            Empty => "holds no reading: only a header, or nothing";
        }
        W1182 "readings are missing in a trace",
        cause: "The length is empty, a word or NaN, or a value far from every length of the bar: loggers write so that there is no reading.",
        cure: "Nothing to do if the instrument lost the target for a moment: these rows are kept as not valid. More than 10 % of the rows are refused: then the column or the unit is wrong." {
            NoReading { rows: u64, samples: u64, percent: f64 } => "{rows} of {samples} rows have no reading ({percent:.2} %), the first in this line: they are not valid";
        }
        I1114 "lines of a trace are left out",
        cause: "Lines below the header or at the end of the file hold no time and length: units, statistics, or a line that was cut off.",
        cure: "Nothing to do, if the message is right." {
            LinesAbove { lines: u64 } => "{lines} lines below the header are left out, from this one: they hold no reading";
            LinesBelow { lines: u64 } => "{lines} lines at the end are left out, from this one: they hold no reading";
            CutOff => "the last line is cut off and left out";
        }
        E1180 "a trace holds no reading of this bar",
        cause: "Every reading is beyond the bar's stroke or marked as not valid: the unit or the kind of the lengths is another, or the bar was not zeroed.",
        cure: "Correct [length] unit and kind in the mapping, or length_mm and stroke_mm of the job's bar." {
            AllInvalid { readings: u64, low_mm: f64, high_mm: f64 } => "none of {readings} readings is valid: they are {low_mm:.3} to {high_mm:.3} mm as readings of the bar";
        }
        W1181 "a trace cannot show the dwells of its plan",
        cause: "The readings come too slowly, share their times, never change or are lengths in another unit; or the trace has holes.",
        cure: "Record at least five readings in a dwell, with their own times; check that the length is the bar's, and give its unit in the mapping ([length] unit)." {
            TooSlow { period_s: f64, dwell_s: f64 } => "the readings come every {period_s:.3} s, and a dwell lasts {dwell_s} s";
            Constant { reading_mm: f64 } => "the length never changes: every reading is {reading_mm:.4} mm";
            OtherUnit { low: f64, high: f64, unit: &'static str, bar_mm: f64 } => "the readings are {low} to {high} mm: are they lengths of the bar of {bar_mm} mm in {unit}?";
            Holes { holes: u64, longest_s: f64 } => "{holes} gaps of more than a second without a reading, the longest {longest_s:.1} s";
            SameTimes { percent: f64 } => "{percent:.0} % of the readings have the same time as the one before";
        }
        W1110 "a trace and its plan have different durations",
        cause: "The trace is of another run, its times are in another unit, or it was cut off.",
        cure: "Check [time] unit in the mapping, and that the plan is the one that was driven." {
            Duration { seconds: f64, planned_s: f64 } => "the trace lasts {seconds:.1} s and the plan {planned_s:.0} s: it is of another run, its times are in another unit, or it was cut off";
        }
        I1113 "a trace lasts longer than its plan at full override",
        cause: "The override was lower, waits for the operator are in the trace, or its times are in another unit or those of another run.",
        cure: "Compare with the override of the run. If it was full, check [time] of the mapping." {
            Longer { seconds: f64, times: f64 } => "the trace lasts {seconds:.0} s, {times:.1} times as long as the plan at full override: are its times right?";
        }
        I1111 "readings of a trace are not valid",
        cause: "They are beyond the bar's stroke, or the trace marks them as not valid.",
        cure: "Nothing to do: they are kept and not used." {
            NotValid { readings: u64 } => "{readings} readings are beyond the bar's stroke or marked as not valid";
        }
        I1112 "the format of times or lengths of a trace was detected",
        cause: "The mapping does not state it (or there is no mapping); the rows show it.",
        cure: "Nothing to do, if the message is right. Else give [time] format or unit, or [length] kind in a mapping." {
            Times { written: &'static str } => "the times are read as {written}";
            Readings { bar_mm: f64 } => "the lengths are read as readings of the bar of {bar_mm} mm";
        }
    }
}
