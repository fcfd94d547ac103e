//! The matching of dwells to poses.

use dbbd_model::findings;

findings! {
    /// What the matching has to say of a run, and why a pose has no length.
    MatchingFinding "Matching of dwells to poses" {
        E1001 "no dwell can be matched to a pose",
        cause: "The capture is of another plan, the program did not run, or the bar sent no usable length while it ran.",
        cure: "Look at the reasons at each pose, and check that the plan is the one that was driven." {
            NothingMatched => "no dwell of the capture can be matched to a pose of the plan: nothing is written";
            NothingValid => "the bar marks every reading of the capture as invalid: nothing is written", help: "is the unit right, and was the bar within its stroke?";
            NothingMoves { reading_mm: f64 } => "the length never changes (a reading of {reading_mm:.3} mm): nothing is written", help: "was the bar mounted, and did the program run?";
            OtherDuration { seconds: f64, planned_s: f64 } => "the capture lasts {seconds:.1} s and the program at least {planned_s:.0} s: nothing is written", help: "does it cover the run, and is the unit of its times right?";
            NoCircle => "no dwell of the capture can be matched to a pose on a circle";
        }
        E1082 "the reading runs against the motion",
        cause: "Where the program lengthens the way to the ball by its sync markers, the reading falls: two wires of the sensor are swapped, or the sign in the definition is wrong. Every identified error would have the wrong sign.",
        cure: "Correct the wiring, or the sign in the protocol or in the mapping of the import, and measure again." {
            ReadingInverted { waves: usize, scale: f64 } => "at {waves} sync marks the reading changes by {scale:.2} times the motion of the robot: its sign is inverted";
        }
        W1081 "the reading is not to scale",
        cause: "The sync markers have a commanded height, and the reading has another: the sensor's scale, its decoding (2x, 4x) or its unit is another than the protocol or the mapping says. A robot whose backlash exceeds twice its repeatability also moves less than commanded.",
        cure: "Check the scale with a gauge block or a known move of the robot (`dbbd bar check`), correct protocol or mapping, and measure again." {
            ReadingScaled { waves: usize, scale: f64, sd: f64 } => "at {waves} sync marks the reading changes by {scale:.3} (u {sd:.3}) times the motion of the robot";
        }
        W1083 "the reading comes too late for the signals of the dwells",
        cause: "Strobe and length came by different ways: a filter, a buffer or a network delays the reading, or a column of the trace was shifted. Lengths at the dwells are then those of the motion before.",
        cure: "Take strobe and length from one device, or shift the column back, and import again." {
            ReadingLate { waves: usize, late_s: f64 } => "at {waves} sync marks the reading comes {late_s:.2} s or more after the signals of the dwells";
        }
        E1084 "the program that ran is one of another plan",
        cause: "The program was written for another plan, or the plan was made again after the program was written. The times between the dwells are drawn from everything that the poses depend on, and they are not those of this plan.",
        cure: "Match the capture with the plan of the program that ran; or write the program of this plan, load all of its modules, and measure again.",
        asks: [Plan] {
            ForeignProgram { module: usize } => "the intervals between the dwells of module {module} are not those of this plan: the program that ran is one of another plan";
        }
        W1085 "the dwells do not show which plan was run",
        cause: "So few dwells were detected that the times between them could also be those of another plan.",
        cure: "Make sure that the program which ran is that of this plan, or measure again." {
            PlanNotShown { dwells: usize } => "the times between {dwells} dwells do not show that the program that ran is this plan's";
        }
        W1086 "the plan was made by an earlier version",
        cause: "The time code of its moves depends on few keys of the job: a program that was written before the job was edited looks like this plan's.",
        cure: "Make sure that program and plan belong together, or make the plan and its program again." {
            CodeOfEarlierVersion => "the plan was made by an earlier version: the run does not show whether its program was written for exactly this plan";
        }
        W1002 "poses were dropped as ambiguous",
        cause: "The program was stopped or started again, the override changed on the way, or the program is not this plan's.",
        cure: "The poses that remain are right with more than 99 %. Where many are dropped, write the program with a strobe or with EthernetKRL.",
        asks: [Synchronisation] {
            AmbiguousPoses { poses: usize, percent: f64 } => "{poses} poses ({percent:.1} %) were dropped: more than one dwell may belong to them";
        }
        W1003 "poses have no length",
        cause: "The capture does not cover the run, the bar sent no usable length, or the plan is not the one that was driven.",
        cure: "Plan the poses that remain, measure them, and give both runs to `identify`: together they are one run. `dbbd sync` gives the reason at each pose.",
        asks: [Remaining] {
            PosesLost { lost: usize, poses: usize, percent: f64 } => "{lost} of {poses} poses ({percent:.1} %) have no length";
        }
        W1004 "a module has more or fewer strobes than dwells",
        cause: "The module was stopped and started again, or the strobe's line is bad.",
        cure: "The dwells of the module are matched by their times. Check the line of the strobe if it happens again." {
            StrobeCount { module: usize, strobes: usize, dwells: usize } => "module {module}: {strobes} strobes were detected, and {dwells} dwells are commanded";
        }
        W1005 "the length at the reference pose drifted",
        cause: "The robot or the bar warmed up, or a ball or a clamp moved.",
        cure: "Let robot and bar warm up, check that the balls sit firmly, and measure again." {
            ReferenceDrift { change_um: f64 } => "the length at the reference pose drifted by {change_um:.1} um over the run";
        }
        W1006 "the measured axis angles are not the commanded ones",
        cause: "Another plan was driven, or the robot was stopped or moved by hand.",
        cure: "Give the plan that was driven; if the robot was moved by hand, measure again.",
        asks: [Plan] {
            OtherPlanDriven { poses: usize, worst_deg: f64 } => "at {poses} poses the measured axis angles are up to {worst_deg:.2} degrees from the commanded ones: was another plan driven?";
            AxesMoved { poses: usize, worst_deg: f64 } => "at {poses} poses the measured axis angles are up to {worst_deg:.2} degrees from the commanded ones, at the others they agree: was the robot stopped or moved by hand?";
        }
        W1007 "readings within dwells are not valid",
        cause: "The bar marked readings as invalid while the robot stood still: it was outside of its stroke, or its line or its supply failed.",
        cure: "The other readings of these dwells are used. Check the bar's stroke and its seat, and measure again where much is missing." {
            InvalidInDwells { invalid: usize, samples: usize, percent: f64, dwells: usize } => "in {dwells} dwells {invalid} of {samples} readings ({percent:.2} %) are not valid";
        }
        W1008 "the bar froze in a part of the run",
        cause: "Its reading stays equal to the last digit while the robot moves from pose to pose, and elsewhere it does not: the device, its line or the software that recorded it repeats an old reading.",
        cure: "Leave out the poses of that time, or measure again. Look at the trace: a live reading changes by its noise, even at rest." {
            Frozen { from_s: f64, to_s: f64, poses: usize, reading_mm: f64 } => "from {from_s:.1} s to {to_s:.1} s, where {poses} poses are due, every reading is {reading_mm:.4} mm";
        }
        W1080 "the controller's reports of its dwells are not used",
        cause: "The bar's clock does not keep the host's pace, as on a simulator that runs faster than real time, or the channel broke, so that no dwell has both a begin and an end report.",
        cure: "Poses are matched by the strobe or by still intervals instead. Simulate in real time; on a real cell check the channel and the bar's clock (`dbbd info`).",
        asks: [Pace] {
            ReportsOffPace { reports: usize } => "the bar's clock does not keep the host's pace: {reports} reports of the controller cannot be placed on its time axis and are not used";
            ReportsUnpaired { reports: usize } => "{reports} reports of the controller came, but no dwell has both a begin and an end report: they are not used";
        }
        W2220 "the published axes are not used",
        cause: "The clock of the bar or of the controller does not keep the host's pace, as on a simulator that runs faster than real time.",
        cure: "Poses are matched by the strobe or by still intervals, and lengths are taken at the commanded axes. Simulate in real time; on a real cell check both clocks (`dbbd info`).",
        asks: [Pace] {
            AxesUnused { packets: usize } => "{packets} axes of the controller cannot be placed on the time axis of the bar and are not used";
        }
        W2222 "an external axis moved during the run",
        cause: "The controller published the positions of a rail or of a table, and they change. The base balls count as standing still in the base of the robot, and on a rail the base of the robot moves.",
        cure: "Measure at one position of the external axes, each position with base balls of its own." {
            ExternalAxisMoved { number: usize, range: f64 } => "external axis E{number} moved by {range:.2} mm or degrees";
        }
        I2221 "lengths are taken at measured axes",
        cause: "The controller published its axes, and they were recorded.",
        cure: "Nothing to do: poses are matched by the axes' own motion, and lengths are identified at the measured angles." {
            AxesMeasured { measured: usize, protocol: &'static str, lag_ms: f64, sd_ms: f64 } => "{measured} lengths are at axes that the controller measured ({protocol}); the reading comes {lag_ms:.2} ms (u {sd_ms:.2}) after them";
            AxesMeasuredLagUnknown { measured: usize, protocol: &'static str } => "{measured} lengths are at axes that the controller measured ({protocol}); no motion shows how late the reading comes";
        }
        I1010 "the measured axis angles are corrected ones",
        cause: "The controller is in its absolute-accuracy mode and corrects its motions by a model of its own.",
        cure: "Nothing to do: the measured axis angles are used." {
            AxesCorrected { poses: usize, worst_deg: f64 } => "at {poses} poses the measured axis angles are up to {worst_deg:.2} degrees from the commanded ones, as in an absolute-accuracy mode";
        }
        I1011 "the quality of the readings",
        cause: "The reading changed within dwells, or samples are missing by their sequence numbers.",
        cure: "Longer settle_s and firmly seated balls reduce creep. Missing samples are counted by `dbbd info`." {
            Creep { dwells: usize } => "in {dwells} dwells the reading drifted by more than its noise (column `creep`)";
            MissingSamples { dwells: usize } => "in {dwells} dwells samples are missing by their sequence numbers";
        }
        I1012 "the bar's clock broke",
        cause: "The bar restarted, or its counter jumped.",
        cure: "Dwells across the break are left out. Check the bar's supply if it happens again." {
            ClockRestarted { at_s: f64, jump_s: f64, host_s: f64 } => "the bar's clock began again at {at_s:.3} s: it changed by {jump_s:+.3} s in {host_s:.3} s";
            ClockJumped { at_s: f64, jump_s: f64, host_s: f64 } => "the bar's clock jumped at {at_s:.3} s: it changed by {jump_s:+.3} s in {host_s:.3} s";
        }
        I1013 "the lag of a continuous circle is not known",
        cause: "The circle was not passed in both directions, so that its lag cannot be estimated.",
        cure: "Plan the circle with direction = \"both\"." {
            OneWayCircle { circle: u32, lag_sd_ms: f64 } => "circle {circle} was not passed both ways: its lag is taken as 0 ms (u {lag_sd_ms:.0})";
        }
        I1014 "the run has not all modules of the plan",
        cause: "The program was started at a later module, or was ended before the last one.",
        cure: "Nothing to do, if another run has the other modules: identify both together. Else plan the poses that remain.",
        asks: [Remaining] {
            SomeModules { first: usize, last: usize, modules: usize } => "the run has the modules {first} to {last} of {modules}";
        }
        I1020 "the capture does not cover a pose",
        cause: "The recording began after the program or ended before it.",
        cure: "Start `dbbd acquire` before the program, and let it end by itself." {
            CaptureBeganLater => "the capture began later";
            CaptureEndedBefore => "the capture ended before";
        }
        I1021 "nothing was detected when a pose was due",
        cause: "The pose was not driven, or its dwell cannot be detected.",
        cure: "Write the program with a strobe or with EthernetKRL, or raise dwell_s and settle_s.",
        asks: [Synchronisation] {
            NoneNearby { dwell: &'static str } => "no {dwell} can be matched to this pose";
            NoneWhenDue { dwell: &'static str, expected_s: f64 } => "no {dwell} at about {expected_s:.1} s, when it was due";
        }
        I1022 "the bar gave no usable reading at a pose",
        cause: "The bar was off its range, too fast, or a ball had left its cup; its line or its clock failed; or the dwell was too short.",
        cure: "Check the seat of the balls and the line, and raise dwell_s or settle_s." {
            SentTooLittle { expected_s: f64 } => "the bar sent too little at {expected_s:.1} s, when it was due";
            NotValid { at_s: f64 } => "the bar marked its readings as not valid at {at_s:.1} s";
            ClockBroke { at_s: f64 } => "the bar's clock broke during the dwell at {at_s:.1} s";
            TooShort { at_s: f64 } => "the dwell at {at_s:.1} s was too short or held too few readings";
            PassedTooFast => "the bar sent too little while the robot passed";
        }
        I1023 "a dwell may belong to several poses",
        cause: "The times between the dwells fit more than one pose.",
        cure: "Write the program with a strobe or with EthernetKRL, which names each dwell.",
        asks: [Synchronisation] {
            AmbiguousDwell { start_s: f64, percent: f64 } => "the dwell at {start_s:.1} s belongs to this pose with a probability of {percent:.0} % only";
        }
        I1024 "a pass without stops has no lengths",
        cause: "When the robot passed is not known: neither a strobe nor a report of the controller shows it, or they do not fit the plan.",
        cure: "Write the program of a continuous circle with a strobe or with EthernetKRL, and run it without stopping it.",
        asks: [Synchronisation] {
            PassNotReported => "the controller did not report it";
            PassWithoutSignal => "neither a strobe nor a report shows when the robot passed: write the program with a strobe or with EthernetKRL";
            PassStrobes { strobes: usize, commanded: usize } => "{strobes} strobes were detected, and {commanded} are commanded";
            PassNotSeen => "the published axes do not pass its points in order";
            PassWithoutEnd => "the plan has no row where it ends";
            PassDuration { seconds: f64, planned_s: f64 } => "the pass lasted {seconds:.1} s, which no override explains ({planned_s:.1} s planned)";
            PassClockBroke => "the bar's clock broke during the pass";
        }
    }
}
