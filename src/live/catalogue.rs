//! The service: its configuration, its API, and runs that end early.

use axum::http::StatusCode;
use dbbd_model::findings;

findings! {
    /// What the service, its API or the recorder refuses.
    ServiceFinding "The service" {
        E1501 "the configuration of the service is not valid",
        cause: "A key of the configuration has a value that cannot be followed.",
        cure: "Correct the line; `dbbd serve` can check it without starting, docs/how-to/service.md explains every key.",
        asks: [ServiceCheck] {
            OutOfRange { value: f64, least: f64, most: f64 } => "{value} must be {least} to {most}";
            NotAnAddress => "no address", help: "an address and a port are needed, as \"127.0.0.1:8230\" or \"[::1]:8230\"";
            OpenWithoutToken => "others could reach this address, and no token is asked for", help: "set `token_file`, or listen on 127.0.0.1";
            NotAProxy => "no address of a proxy", help: "the addresses under which the service sees its proxies, as [\"127.0.0.1\"]";
            NotAHost => "no name of a host", help: "a name without scheme and port, as \"cell-3.local\"";
            ParametersWithoutProtocol => "`device.params` needs `device.protocol`";
            NotADirectory => "`data` and `plans` are directories, and this is none";
            OneDirectory => "`data` and `plans` are one directory", help: "give runs and plans a directory each";
            NoPlans => "`plans` is not a directory";
            NotAStroke => "the stroke is [lowest, highest] reading, mm";
            NotReadings { low: f64, high: f64 } => "[{low}, {high}] are no readings: are they lengths of the bar?", help: "the stroke is [lowest, highest] reading, mm: length minus that of the bar";
            NotAProtocol { name: String, why: String } => "`{name}` is neither a built-in protocol nor a file: {why}", help: "`dbbd protocols` lists what is built in";
            TokenUnreadable { why: String } => "the token cannot be read: {why}";
            TokenOpen => "every user of this machine may read the token", help: "chmod 640 the file, or 600";
            NotAUser { why: &'static str } => "no user: {why}", help: "name, role (\"look\", \"measure\" or \"plan\") and token_hash: the SHA-256 of the token, as `printf %s TOKEN | sha256sum` prints it";
            TokenTooShort => "a token has 16 or more visible ASCII characters and no space", help: "make one: `openssl rand -hex 24`";
        }
        E1502 "the service cannot start",
        cause: "Another program (another dbbd?) has the address, or it is none of this computer.",
        cure: "Stop the other program, or choose another `address` in the configuration." {
            NotServing { address: String, why: String } => "{address} cannot be listened on: {why}", help: "another dbbd may run; choose another `address` in the configuration";
        }
        E1503 "there is no such run, job, plan or file",
        cause: "The name is mistyped, the file was removed, or a job is too old to be remembered.",
        cure: "Ask for the list: /api/v1/runs, /api/v1/jobs, /api/v1/plans. A plan is looked for as NAME/plan.csv in the directory `plans`." {
            NoRun { run: String } => "there is no run `{run}`";
            NoResult { file: String } => "there is no result `{file}`";
            NoFile { run: String, file: String } => "there is no file `{file}` of run `{run}`";
            NoJob { job: String } => "there is no job {job}";
            NoPlan { plan: String } => "there is no plan `{plan}`";
            NoSuchPort { port: String } => "there is no port `{port}`";
            NoSuchProtocol { protocol: String } => "there is no protocol `{protocol}`";
            NoRobot { robot: String } => "there is no robot `{robot}`";
            NoResultKind { kind: String } => "`{kind}`: results are of sync, identify or circle";
            NothingHere => "there is nothing here";
        }
        E1504 "not possible in the present state",
        cause: "One run at a time is recorded, a run needs a port, and a run's name is used once.",
        cure: "Stop the run that is on, choose a port, or give another name." {
            RunIsOn => "a run is on: stop it first";
            ThisRunIsOn { run: String } => "run `{run}` is on: stop it first";
            RunIsStarting => "the run is just starting";
            NoRunIsOn => "no run is on";
            Ending => "dbbd is about to end";
            NoPortChosen => "no port was chosen";
            PortAway { port: String } => "there is no port `{port}`: plug the bar in";
            NameTaken { run: String } => "there is a run `{run}` already: choose another name";
            ProtocolNotBuiltIn { protocol: String } => "the plan's protocol `{protocol}` is not built in: configure it";
            RobotTaken { robot: String } => "there is a directory `{robot}` already: choose another name";
            StepTooEarly { step: &'static str } => "`{step}` cannot be computed yet: an earlier step comes first";
            RobotIsMeasured { robot: String, run: String, by: String } => "`{robot}` is being measured (run `{run}`, started by {by}): its job, plan and programs are locked", help: "stop the run first, or wait for its end";
            LinkedDirectory { directory: String } => "`{directory}` is a link or holds one", help: "files are written inside the working directory only: remove the link";
            LinkedResults { run: String, kind: String } => "`{kind}` of run `{run}` is a link or holds one", help: "results are written inside the data directory only: remove the link";
            DataUnwritable { why: String } => "the data directory cannot be written: {why}";
        }
        E1505 "a request's content is not valid",
        cause: "A value of the request is outside of what it can be.",
        cure: "/api/v1/openapi.json describes every request." {
            RunName => "a run's name has 1 to 64 letters, digits, `.`, `_`, `-`, and begins with a letter or digit";
            RobotName => "a robot's name has 1 to 64 letters, digits, `.`, `_`, `-`, and begins with a letter or digit";
            Speed { most: f64 } => "a simulated cell runs at a speed above 0 and at most {most}";
            ProgramName { name: String } => "`{name}` is no file of a robot program", help: "KRL .src and .dat, RAPID .mod and .pgf, URScript .script";
            JobKey { key: String } => "the key `{key}` of the job cannot be set to this value";
            RunDuration { most_s: f64 } => "duration_s must be above 0 and at most {most_s}";
            OptionOfAnotherJob { option: String } => "`{option}` belongs to identify";
            OptionValue { option: String, value: String } => "`{option}` cannot be `{value}`";
            RemarkLength { most: usize } => "a remark has 1 to {most} characters, none of which is a control character";
            BodyContent { why: String } => "{why}";
        }
        E1506 "too many at once",
        cause: "More jobs wait than the service keeps, or too many wrong tokens came from this address within a minute. The right token is accepted nevertheless.",
        cure: "Wait a minute, or until some jobs have ended." {
            TooManyJobs => "too many jobs wait already";
            TooManyGuesses => "the token is wrong, as too many from this address were: wait a minute";
        }
        E1507 "the service failed",
        cause: "A thread of the service ended, or the disk or the system failed: a fault of dbbd or of the computer, not of the request.",
        cure: "Look into the service's log, check disk and memory, and start the service again." {
            WorkerLost { worker: String } => "the thread `{worker}` of dbbd has ended: start dbbd again";
            RecorderDied => "the recorder died; what it wrote before is kept";
            DataUnreadable { why: String } => "the data directory cannot be read: {why}";
            CommandFailed { why: String } => "the command cannot be run: {why}";
            Unwritten { why: String } => "the answer cannot be written: {why}";
        }
        E1508 "this client may not ask",
        cause: "The request names another host, comes from a page of another site, or has no token.",
        cure: "Ask by address or by a name under `hosts`, and send the token; docs/reference/security.md." {
            NoHost => "one Host header is needed";
            OtherHost => "this Host is not served here", help: "name it under `hosts` in the configuration, or ask by address";
            OtherSite => "a page of another site may not ask here";
            NoToken => "the token is missing or wrong", help: "send it as `Authorization: Bearer TOKEN`, or give it to the page";
            WrongToken => "the token is wrong";
            RoleTooLow { role: &'static str, needed: &'static str } => "this needs the role `{needed}`, and this user has `{role}`", help: "sign in as another user, or change `role` in the configuration";
        }
        E1510 "a job names a file outside of its directory",
        cause: "`robot` or `[bar] protocol` of the job names a file of the server that is not in the directory of the robot.",
        cure: "Copy the file into the directory of the robot, and name it without a path; or name a built-in robot or protocol." {
            NamedOutside { file: String } => "{file} is not in the directory of the robot";
        }
        E1512 "the job was changed meanwhile",
        cause: "Somebody else, or the command line, has changed the file of the job since it was read: saving now would undo that change.",
        cure: "Open the form again: it shows the job as it is now. What was typed is still there until it is closed." {
            JobChanged => "the job was changed by somebody else since it was opened: nothing was saved";
        }
        E1511 "a job was ended",
        cause: "It took more time or memory than a job of the service may.",
        cure: "Compute it with the command line, or with less: fewer candidates, a smaller table." {
            JobTooLong { max_s: f64 } => "the job was ended after {max_s:.0} s";
            JobEnded { max_bytes: u64 } => "the job ended without an answer: it may have needed more than {max_bytes} bytes of memory";
        }
        E1509 "a request's form is not valid",
        cause: "The method, the path, the type or the size of a request is not what the API takes.",
        cure: "/api/v1/openapi.json describes every request." {
            NotAllowed { methods: &'static str } => "only {methods} is allowed here";
            PathTooLong => "the path is too long";
            PathNotText { why: String } => "{why}";
            BodyNotJson => "the body must be JSON", help: "Content-Type: application/json";
            BodySyntax { why: String } => "{why}";
            BodyTooSlow => "the body took too long";
            BodyTooLong { max_bytes: usize } => "a body has at most {max_bytes} bytes";
        }
        E1520 "the bar cannot be set to zero",
        cause: "Its protocol has no command for it, or the bar is not being read.",
        cure: "Connect the bar first; where there is no command, the offset is estimated with the other parameters." {
            NoZeroCommand { protocol: String } => "the protocol `{protocol}` has no command that sets the reading to zero";
            NotRead => "the bar is not being read: connect it first";
        }
    }
}

impl ServiceFinding {
    /// The HTTP status of an answer with this finding.
    #[expect(
        clippy::wildcard_enum_match_arm,
        reason = "a finding that is not listed is a conflict with the state"
    )]
    pub fn http_status(&self) -> StatusCode {
        match self {
            Self::NoRun { .. }
            | Self::NoResult { .. }
            | Self::NoFile { .. }
            | Self::NoJob { .. }
            | Self::NoPlan { .. }
            | Self::NoSuchPort { .. }
            | Self::NoSuchProtocol { .. }
            | Self::NoResultKind { .. }
            | Self::NoRobot { .. }
            | Self::NothingHere => StatusCode::NOT_FOUND,
            Self::RunName
            | Self::RobotName
            | Self::Speed { .. }
            | Self::ProgramName { .. }
            | Self::JobKey { .. }
            | Self::RunDuration { .. }
            | Self::OptionOfAnotherJob { .. }
            | Self::OptionValue { .. }
            | Self::RemarkLength { .. }
            | Self::NamedOutside { .. }
            | Self::BodyContent { .. } => StatusCode::UNPROCESSABLE_ENTITY,
            Self::TooManyJobs | Self::TooManyGuesses => StatusCode::TOO_MANY_REQUESTS,
            Self::WorkerLost { .. }
            | Self::RecorderDied
            | Self::DataUnreadable { .. }
            | Self::CommandFailed { .. }
            | Self::Unwritten { .. } => StatusCode::INTERNAL_SERVER_ERROR,
            _ => StatusCode::CONFLICT,
        }
    }
}
