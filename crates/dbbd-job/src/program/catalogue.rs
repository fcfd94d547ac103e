//! Programs: read, executed, written.

use dbbd_model::findings;

findings! {
    /// A program that cannot be read, executed or written.
    ProgramFinding "Programs" {
        E0801 "a word of a program is not valid",
        cause: "The file is not plain ASCII outside of comments, or a number, a text or a name has a form that controllers refuse.",
        cure: "Correct the word at the place named. Numbers have a decimal point; save the file as plain ASCII." {
            ByteOrderMark => "the file begins with a byte order mark", help: "save it as plain ASCII: controllers do not read it";
            UnknownCharacter { character: char, language: &'static str } => "`{character}` has no meaning in {language}", help: "outside of comments and texts a program is plain ASCII";
            OpenText => "this text has no closing quote";
            NotBinaryOrHexadecimal => "this is not a number", help: "binary numbers are written 'B0101', hexadecimal ones 'HFF'";
            NumberOutOfRange { number: String } => "{number} is out of range";
            LongName { name: String } => "the name {name} is longer than 24 characters", help: "controllers cut or refuse longer names";
        }
        E0802 "the folds of a program are not balanced",
        cause: "A ;FOLD has no ;ENDFOLD, or an ;ENDFOLD has no ;FOLD.",
        cure: "Add the missing line or remove the other one; folds may be nested." {
            FoldNotClosed => "this fold is not closed";
            FoldNotOpen => "no fold is open here";
        }
        E0803 "a line of a program cannot be read",
        cause: "A word is missing, mistyped or in the wrong place. A decimal comma separates two numbers.",
        cure: "Correct the line; the message names the column." {
            Expected { expected: String, found: String } => "expected {expected}, found {found}";
            NoStatement { word: String } => "`{word}` does not begin a statement",
                help: "supported are assignments, calls, PTP, LIN, CIRC, WAIT, PULSE, HALT, FOR, IF, WHILE, LOOP";
            NoBlock => "`end` ends nothing here";
            GivenTwice { name: String } => "{name} is given twice";
            LateDeclaration => "a declaration after the first statement",
                help: "move it above the first statement of the routine, or into the .dat file";
            ArraySize { elements: i64, most: usize } => "an array cannot have {elements} elements: all arrays of a file hold at most {most} numbers";
            TooManyFields { most: usize } => "a structure has at most {most} components";
        }
        E0804 "a program uses what is not supported",
        cause: "Controllers accept more of the language than dbbd reads, and the simulated controller executes only what can be executed in exact stops.",
        cure: "Write the program without it where it is to be simulated. `dbbd compensate` passes over statements that move nothing." {
            Unsupported { what: String, instead: String } => "{what} is not supported", help: "{instead}";
        }
        E0805 "a program is nested too deeply",
        cause: "Blocks, brackets or calls are inside each other more often than any program needs; a routine that calls itself does not end.",
        cure: "Split the expression or the routine." {
            NestedTooDeeply { most: usize } => "nested more than {most} times";
            TooManyOperators { most: usize } => "more than {most} operators in one line";
        }
        E0806 "the files of a program do not belong together",
        cause: "A module is called whose file is not beside the program, or a file is named otherwise than the module in it.",
        cure: "Put all modules into one directory, and give the .src, the .dat and the first routine one name." {
            NoRoutine => "the file has no routine", help: "a .src file begins with DEF NAME ( )";
            NoProc => "the module has no routine", help: "a module has PROC name() .. ENDPROC";
            NoDef => "the script has no routine", help: "a script has def name(): .. end";
            SecondRoutine { name: String } => "a second routine {name}";
            NoModuleFile => "there is no such file";
            OtherModuleName { routine: String, file: String } => "DEF {routine} is in a file named {file}";
            OtherPlansData { data: String, plan: String, data_plan: String } => "was written for plan {plan}, and {data} for plan {data_plan}", help: "copy both files of the module again from one directory";
            OtherDataName { data: String, module: String } => "DEFDAT {data} does not belong to {module}.src";
            NoSuchRoutine { name: String } => "{name} is called, and there is no {name}.src beside this file",
                help: "define it in this file or put its module beside it";
        }
        E0807 "a .dat file has no logged axis angles of dbbd",
        cause: "The file is not the .dat of a module that `dbbd krl` wrote, or a line of it was changed.",
        cure: "Fetch the .dat files from the controller after the run, and give them unchanged." {
            NoLoggedAxes => "the file has no arrays DBBROW and XQ";
            NoRowOfPlan { element: i64 } => "DBBROW[{element}] is not the number of a row of the plan";
            NotAxisAngles => "expected axis angles";
        }
        E0808 "a position is not complete",
        cause: "The value is not a structure of numbers, or a component is missing. A controller takes a missing component from where the robot is.",
        cure: "Give all six components, as in {X 1300.0,Y 0.0,Z 800.0,A 0.0,B 90.0,C 0.0}." {
            NoPosition => "this is not a position";
            ComponentMissing { component: &'static str } => "{component} is missing";
            NotConstant { name: String } => "{name} has no value before the program runs";
        }
        E0810 "a value is not of the type that is needed",
        cause: "A number, a truth value, a text or a structure is used in place of another, an array is used without index, or a variable was never set.",
        cure: "Compare the declaration with the use; the message names both types." {
            WrongType { expected: &'static str, found: &'static str } => "expected {expected}, found {found}";
            IntTooLarge { value: f64 } => "{value} is too large for an INT";
            NotSet { name: String } => "{name} has no value yet";
            NoComponent { component: String } => "there is no component {component}";
            NotAnArray => "this is not an array";
            IndexOutside { index: i64, elements: usize } => "index {index} is outside of the array's 1 to {elements}";
            ArrayAsWhole => "an array is set element by element";
            CannotStore { found: &'static str } => "{found} cannot be stored here";
        }
        E0811 "a name of a program is not known",
        cause: "A variable is not declared, or is declared in another module; or the simulated controller has no such system variable or type.",
        cure: "Declare it in the routine or in the module's .dat. The simulator knows the variables that `dbbd krl` uses." {
            NotDeclared { name: String } => "{name} is not declared, neither in the routine nor in the module's .dat";
            NoSystemVariable { name: String } => "the simulator has no {name}";
            SystemVariableMistyped { name: String, near: String } => "the simulator has no {name}", help: "did you mean {near}?";
            NoType { name: String } => "the type {name} is not simulated";
            DeclaredTwice { name: String } => "{name} is declared twice";
            ParameterNotDeclared { routine: String, parameter: String } => "{routine}: the parameter {parameter} is not declared";
        }
        E0812 "a calculation has no result",
        cause: "A division by zero, or a result that is too large.",
        cure: "Check the values that the program computes with." {
            NoResult => "the result is too large, or a division by zero";
        }
        E0813 "the robot cannot make a motion",
        cause: "The point is out of reach, an axis leaves its limits or would have to turn too fast near a singularity, or the points of an arc are on a line.",
        cure: "Change the point, its status and turn, or the speed." {
            AxisLimit { axis: usize, angle_deg: f64, low_deg: f64, high_deg: f64 } =>
                "axis {axis} leaves its limits: {angle_deg:.3} deg, allowed {low_deg} to {high_deg}";
            AxisSpeed { axis: usize } => "axis {axis} would have to turn faster than it can",
                help: "the path is too near to a singularity, or its speed is too high";
            NoAxisAngles { why: String } => "{why}";
            NoConfiguration { value: i64 } => "S or T is {value}";
            OtherConfiguration { programmed: String, reached: String } =>
                "the motion ends in the configuration {reached}, not in {programmed}", help: "compute the confdata again, or switch ConfL\\Off";
            StraightArc => "the three points of the arc are on a line", help: "move the auxiliary point, or write LIN";
        }
        E0814 "a motion lacks its start or its speed",
        cause: "A program begins with a motion whose start is not known, or a speed or an acceleration has no usable value.",
        cure: "Begin with a PTP to an axis position, and set speeds in m/s and degrees/s before the motion." {
            FirstMotion => "the first motion of a program is a PTP to an axis position, or to a position with S and T";
            NoSpeed { variable: String } => "{variable} must be above zero";
            TooFast { m_per_s: f64 } => "$VEL.CP={m_per_s} is faster than the robot", help: "$VEL.CP is in m/s, not mm/s";
        }
        E0815 "a program does not end",
        cause: "A loop takes no time or never ends, or EXIT is outside of a LOOP.",
        cure: "Put a WAIT or a motion into the loop, and give FOR a step other than 0." {
            NeverWaits => "the program loops without ever taking time";
            ExitOutsideLoop => "EXIT is outside of a LOOP";
            ZeroStep => "a STEP of 0 never ends";
        }
        E0816 "an input, an output or a setting cannot be set to this value",
        cause: "The number of the input or output, the time of a pulse or a percentage is out of range, or the variable can only be read.",
        cure: "Outputs are $OUT[1] to $OUT[4096]; a pulse lasts 0.012 to 3 s; percentages are 1 to 100." {
            NoOutput => "this is not an output";
            NoSignal => "a signal names $OUT[n] or $IN[n], n from 1 to 4096";
            SignalWidth => "a signal has 1 to 32 outputs in a row";
            InputSet => "an input cannot be set";
            NotOnOutputs { value: i64, outputs: usize } => "{value} does not fit on {outputs} outputs";
            PulseTime { seconds: f64 } => "a pulse of {seconds} s: 0.012 to 3 are possible";
            NotPercent { value: f64 } => "{value} is not a percentage";
            ReadOnly { name: String } => "{name} cannot be set";
        }
        E0817 "a routine is called with the wrong arguments",
        cause: "The call has more or fewer arguments than the routine has parameters.",
        cure: "Compare the call with the first line of the routine." {
            Arguments { routine: String, expected: usize, given: usize } => "{routine} takes {expected} arguments, {given} are given";
            BasCommand => "BAS takes a command like #VEL_PTP and a value";
        }
        E0818 "EthernetKRL is used before its channel is open",
        cause: "The functions of EthernetKRL are called in another order than EKI_Init, EKI_Open, EKI_Send, EKI_GetInt, or nothing listens.",
        cure: "Start `dbbd acquire` with an address for telegrams first, then the program, in the simulator with the same address.",
        asks: [Telegrams] {
            ChannelClosed => "the channel is not open", help: "EKI_Open comes first";
            NoListener => "nothing listens to the channel", help: "give the server's address";
            NoAnswer => "no answer has come", help: "wait for its flag first";
            NoSuchAnswer { path: String } => "the answer has no {path}";
        }
        E0820 "a row of the plan cannot be written to a program",
        cause: "plan.csv was changed by hand, and a number is out of what a controller accepts or rows are in an order that has no motion.",
        cure: "Make the plan again with `dbbd plan`." {
            RowNumber { row: u32, value: f64 } => "row {row}: {value} is not a length or an angle that a controller accepts";
            RowConfiguration { row: u32, status: u8, turn: u8 } => "row {row}: status {status} and turn {turn} are out of range";
            RowDwell { row: u32, dwell_s: f64 } => "row {row}: a dwell of {dwell_s} s";
            RowAxisSpeed { row: u32, percent: f64 } => "row {row}: an axis speed of {percent} percent";
            RowFeed { row: u32, feed_mm_s: f64 } => "row {row}: a feed of {feed_mm_s} mm/s";
            RowTurn { row: u32, turn_deg_s: f64 } => "row {row}: an orientation speed of {turn_deg_s} deg/s";
            RowOtherBall { row: u32, ball: u32, circle_ball: u32 } => "row {row}: ball {ball} in a circle about ball {circle_ball}";
            RowStart { row: u32 } => "row {row}: a program must begin with a PTP to where the bar is mounted";
            RowArc { row: u32 } => "row {row}: an arc needs its auxiliary point in the transit row before";
        }
        E0821 "a plan has no program",
        cause: "plan.csv and plan.json are of two plans, the plan has no rows, or a ball is missing in the job.",
        cure: "Keep both files as `dbbd plan` wrote them, side by side." {
            NoRows => "the plan has no rows";
            OtherMoves { rows: usize, moves: usize } => "the plan has {rows} rows and {moves} move times: plan.csv and plan.json do not match";
            OtherMove { row: u32, index: u32 } => "the move time of row {row} has index {index}: plan.csv and plan.json do not match";
            NoBall { ball: u32 } => "the job has no ball {ball}";
        }
        E0822 "a module of the program is too large",
        cause: "A circle has more dwells than the index on eight outputs can count, or more lines than old controllers load.",
        cure: "Give the circle fewer points, or split it in the job." {
            TooManyDwells { circle: u32, dwells: usize, most: u32 } => "circle {circle}: {dwells} dwells, at most {most}";
            TooManyLines { circle: u32, lines: usize, most: usize } => "circle {circle}: {lines} lines, at most {most}";
        }
        E0880 "the address of the server of telegrams cannot be used",
        cause: "Only a program that reports over EthernetKRL connects to it, and a controller needs its port.",
        cure: "Write the program for EthernetKRL with the address at which `dbbd acquire` listens for telegrams, or leave the server out.",
        asks: [TelegramServer, Synchronisation] {
            ServerUnused => "a server of telegrams applies only with EthernetKRL";
            ServerAddress { server: String } => "no controller connects to {server}", help: "give the address of this computer in the controller's network";
            ServerPort => "the server needs a port other than 0: the one at which `dbbd acquire` listens for telegrams";
        }
        I0881 "the address of the server of telegrams is the controller itself",
        cause: "127.x.x.x is the computer on which the program runs: on a robot that is its controller.",
        cure: "Give the address of this computer in the controller's network; for `dbbd simulate` nothing needs to be done.",
        asks: [TelegramServer] {
            ServerLoopback { server: String } => "{server} is the controller itself, unless it is a simulated one";
        }
        W0882 "modules of another plan are in the directory",
        cause: "The program was written into a directory that holds modules of an earlier plan.",
        cure: "Remove the modules that are named, or write into an empty directory: load only those of one plan." {
            StaleModules { modules: String } => "the directory holds modules that are not of this plan: {modules}";
        }
        W0885 "the job or the robot file was changed after the plan was made",
        cause: "The file is not the one that the plan was made from: the program is one of the earlier job or robot.",
        cure: "Plan the job again, and write the program of that plan; or go on, if the program shall be that of the earlier file." {
            SourceChanged { source: String } => "{source} was changed after the plan was made: the program is that of the earlier file";
        }
        E0884 "a module has the name of its routine",
        cause: "In RAPID modules and routines share their names, and a controller refuses to load such a module.",
        cure: "Rename the module or the routine." {
            ModuleNamedAsRoutine { name: String } => "the module and a routine in it are both named {name}";
        }
        E0883 "a plan needs a feature that a language does not have",
        cause: "Circles without stops are one motion further round than an arc of RAPID, URScript or a FANUC goes, and EthernetKRL is KUKA's.",
        cure: "Plan dwells in place of continuous circles, or synchronise by the strobe or by markers; or write KRL.",
        asks: [Synchronisation, Controller] {
            NoPasses { language: &'static str } => "circles without stops are not written in {language}";
            NoTelegrams { language: &'static str } => "EthernetKRL is of KUKA controllers, not in {language}";
            NoController { language: &'static str } => "the controller is the generation of a KUKA controller, not used in {language}";
        }
        E0823 "the chosen way to mark dwells is not possible",
        cause: "The outputs in the job overlap or are not eight in a row, the controller is too old for EthernetKRL, or the bar's protocol does not carry the strobe.",
        cure: "Correct [motion.outputs] in the job, or choose another synchronisation.",
        asks: [Synchronisation, TelegramServer] {
            OutputsOverlap => "outputs: the index needs eight outputs in a row, and the strobe another";
            OutputNumber { output: u32 } => "outputs: there is no standard output {output}", help: "URScript has the outputs 0 to 7, and the index on the eight configurable ones";
            NoEthernetKrl => "EthernetKRL needs a KR C4 or later";
            NoServer => "EthernetKRL needs the address of the server of telegrams";
            NoStrobe { protocol: String } => "the bar's protocol {protocol} does not carry the strobe", help: "synchronise by markers or by EthernetKRL";
            PassWithoutStrobe { protocol: String } => "circles without stops need a strobe, which the bar's protocol {protocol} does not carry", help: "synchronise by EthernetKRL";
            ProtocolNotHere { protocol: String } => "the bar's protocol {protocol} is not here, so it is not known whether it carries a strobe", help: "choose the synchronisation, or go to where the definition is";
        }
        E0824 "a robot is programmed in another language",
        cause: "The robot file names another language than the one that is written or read, or another maker in the robot's name.",
        cure: "Choose the language of the robot, or write and correct its program by other means. If the controller reads KRL, add language = \"krl\" to the robot file and plan again; for `dbbd simulate`, which moves any robot, give the simulated controller.",
        asks: [Language, Controller] {
            OtherLanguage { robot: String, language: String, wanted: &'static str } => "{robot} is programmed in {language}, not in {wanted}";
        }
        W0825 "circles without stops cannot be read with sync markers",
        cause: "Between two passes there is no sync marker, so that their points are reported as missing.",
        cure: "Synchronise by the strobe or by EthernetKRL.",
        asks: [Synchronisation] {
            PassWithMarker => "the points of circles without stops are not matched by markers";
        }
        I0826 "dwells are marked by sync markers",
        cause: "The bar's protocol does not carry the strobe, and no synchronisation is chosen.",
        cure: "Nothing to do. With EthernetKRL no dwell is lost.",
        asks: [Synchronisation] {
            MarkerChosen { protocol: String } => "the bar's protocol {protocol} does not carry the strobe: dwells are marked by sync markers";
        }
        I0827 "the language of a robot is not known",
        cause: "The robot file has no `language`, and the robot's name begins with no known maker.",
        cure: "Add language = \"krl\", \"rapid\", \"urscript\" or \"fanuc\" to the robot file." {
            LanguageNotKnown { robot: String, wanted: &'static str } => "it is not known whether {robot} is programmed in {wanted}";
        }
    }
}
