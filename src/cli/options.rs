//! The option of each input that a finding asks for.

use std::collections::BTreeSet;

use clap::{Arg, ArgMatches, Command};
use dbbd_model::diagnostic::Input;

/// The options for the inputs that a finding asks for, with what they give, if `is_option` has their names; `None` if there
/// are none.
pub(crate) fn options_of(asks: &[Input], is_option: impl Fn(&str) -> bool) -> Option<String> {
    let named = |input: &Input| {
        let (option, what) = option(*input);
        let name = option.trim_start_matches('-').split([' ', ',']).next()?;
        is_option(name).then(|| format!("{option} ({what})"))
    };
    let named: Vec<String> = asks.iter().filter_map(named).collect();
    (!named.is_empty()).then(|| named.join(", "))
}

/// The names of the long options that the called command has.
pub(crate) fn long_options(command: &Command, called: &ArgMatches) -> BTreeSet<String> {
    let inner = called.subcommand().and_then(|(name, called)| Some((command.find_subcommand(name)?, called)));
    match inner {
        Some((command, called)) => long_options(command, called),
        None => command.get_arguments().filter_map(Arg::get_long).map(str::to_owned).collect(),
    }
}

/// The option, and what it gives.
fn option(input: Input) -> (&'static str, &'static str) {
    match input {
        Input::Archive => ("--archive URL", "database of the archive"),
        Input::BallsKept => ("--balls-kept", "base balls mounted as in the calibration"),
        Input::BarUncertainty => ("--bar-u MM", "standard uncertainty of the bar"),
        Input::BaseBalls => ("--centres C.csv", "base balls"),
        Input::BaseFrame => ("--base X,Y,Z,A,B,C", "base"),
        Input::CertificateTemperature => ("--certified C", "temperature of the certificate"),
        Input::CircleRepeatability => ("--repeat-u MM", "repeatability of a circular test"),
        Input::Controller => ("--controller NAME", "controller"),
        Input::ControllerModel => ("--controller-model nominal", "model of the controller"),
        Input::ControllerConfig => (
            "--config FILE",
            "the tools and frames of the controller: $config.dat, a module of RAPID, SYSFRAME.VA",
        ),
        Input::Coupled => ("--coupled yes|no", "whether axis 3 is shown against the horizontal"),
        Input::Dates => ("--dates DATE,..", "dates of the results"),
        Input::Estimated => ("--estimate LIST", "parameters that are estimated"),
        Input::Exclude => ("--exclude ROWS", "rows that are left out"),
        Input::Expansion => ("--expansion PER_K", "expansion of the bar"),
        Input::Fault => ("--fault NAME=VALUE", "fault"),
        Input::Fixed => ("--hold LIST", "parameters that are fixed"),
        Input::Folds => ("--folds N", "folds of the validation"),
        Input::GoneTime => ("--gone S", "how long the bar may be away"),
        Input::HandBackTarget => ("--for TARGET", "target"),
        Input::Identity => ("--identity FILE", "identity"),
        Input::InterimCheck => ("--check", "plan of an interim check"),
        Input::Language => ("--language NAME", "language of the program"),
        Input::Limit => ("--limit MM", "largest correction"),
        Input::Link => ("--link PATH", "name of the line"),
        Input::ListenAddress => ("--listen ADDRESS", "address of the line"),
        Input::ListenOnly => ("--listen", "send nothing"),
        Input::LoggedAxes => ("--axes FILE.dat", "logged axis angles"),
        Input::MachineExpansion => ("--machine-expansion PER_K", "expansion of the machine"),
        Input::Maker => ("--maker MAKER", "maker of the arm"),
        Input::MeasuredLengths => ("--measured OBS.csv", "lengths of earlier stages"),
        Input::Model => ("--model MODEL", "model"),
        Input::Out => ("--out PATH", "result"),
        Input::Pace => ("--speed X", "speed of the simulation"),
        Input::PendantPose => ("--at A1,..,A6=X,Y,Z", "a pose as the pendant shows it"),
        Input::Plan => ("--plan PLAN.csv", "plan that was driven"),
        Input::Port => ("--port PORT", "port of the bar"),
        Input::Positions => ("--positions POS.csv", "positions"),
        Input::Prior => ("--prior none|posterior|datasheet|FILE", "prior"),
        Input::Protocol => ("--protocol NAME|FILE", "protocol of the bar"),
        Input::ProtocolParameter => ("--param NAME=VALUE", "parameter of the protocol"),
        Input::PublishedAxes => ("--axes ADDRESS", "published axes"),
        Input::Radius => ("--radius MM", "nominal radius"),
        Input::Remaining => ("--remaining RUN..", "runs whose other poses are planned"),
        Input::Repeat => ("--repeat RUN[:ROWS]", "poses that are measured again"),
        Input::Replace => ("--replace", "replace earlier files"),
        Input::Risk => ("--risk P", "risk of a wrong decision"),
        Input::Robot => ("--robot NAME|FILE|DIR", "robot"),
        Input::Save => ("--save DIR", "what was received"),
        Input::Search => ("--search TEXT", "part of a name"),
        Input::ServiceCheck => ("--check", "check of the configuration"),
        Input::SetUpRelation => ("--same-setup, --new-setup", "set-up of the parts"),
        Input::Sigma => ("--sigma MM", "standard deviation of a length"),
        Input::Since => ("--since DATE", "begin"),
        Input::Specimen => ("--specimen", "specimen"),
        Input::Spool => ("--spool DIR", "spool"),
        Input::Stage => ("--stage N", "poses of a stage"),
        Input::StartAxes => ("--start A1,..,A6", "axis angles before the program"),
        Input::Store => ("--store URL", "store of the archive"),
        Input::Synchronisation => ("--sync marker|output|ekrl", "synchronisation"),
        Input::TelegramServer => ("--server ADDR:PORT", "server in the program"),
        Input::Telegrams => ("--ekrl ADDR:PORT", "address for telegrams"),
        Input::Tolerance => ("--tolerance MM", "tolerance"),
        Input::ToolBall => ("--tool X,Y,Z", "tool ball"),
        Input::ToolFrame => ("--tool X,Y,Z,A,B,C", "tool"),
        Input::Until => ("--until DATE", "end"),
        Input::Update => ("--update", "updated robot"),
        Input::Urdf => ("--urdf-in FILE", "URDF"),
        Input::UrdfJoints => ("--joints NAMES", "joints of the URDF"),
        Input::Validation => ("--validate OBS.csv", "lengths for validation"),
        Input::World => ("--world WORLD.toml", "simulated world"),
        Input::Zero => ("--zero", "zero of the bar"),
    }
}
