//! `dbbd simulate`.

use dbbd_model::base::text::unreadable;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use serde_json::json;

use super::{CommandOutcome, CommandOutput, robots, value};
use crate::daemon::stop_on_signal;
use dbbd_device::axes::AxesAddress;
use dbbd_device::port::PortAddress;
use dbbd_job::files;
use dbbd_job::plan::DEFAULT_PROTOCOL;
use dbbd_job::program::{Language, Program, Text, fanuc, krl, provenance, rapid, urscript};
use dbbd_job::request;
use dbbd_job::request::compensate::program_language;
use dbbd_job::robot_files::RobotName;
use dbbd_job::sim::SimulationFinding;
use dbbd_job::sim::axes::{AxesLine, AxesPublisher};
#[cfg(unix)]
use dbbd_job::sim::bar::TerminalLink;
use dbbd_job::sim::bar::{ReadingSource, SimulatedReading, Terminal, VirtualBarOptions, serve_over};
use dbbd_job::sim::ekrl::EkrlClient;
use dbbd_job::sim::fault::{FaultyLine, InjectedFaults};
use dbbd_job::sim::world::WorldSetup;
use dbbd_job::sim::{ControllerMoment, SimulatedController, World, truth};
use dbbd_model::base::FileFinding;
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::provenance::{Artefact, ArtefactRole, TracedArtefact};
use dbbd_model::robot::{LoadedRobot, Robot};

/// How long the bar streams after the end of the program, s, so that the end mark is complete.
const AFTER_END_S: f64 = 3.0;

/// The clock of the controller at the start, ticks, as if it had run for some days.
const FIRST_TICKS: u64 = 300_000_000;

/// The robot and the tool ball of the examples, where nothing is named.
const EXAMPLE_ROBOT: &str = "kr60ha";
const EXAMPLE_TOOL_MM: [f64; 3] = [30.0, 20.0, 10.0];

/// Execute a robot program on a simulated robot with a virtual ball-bar.
///
/// The program is the only source of the robot's motion. The true robot differs from that of the controller. The bar sends
/// the true lengths through a pseudo-terminal, or with --listen through the network; its address for `acquire --port` is
/// printed on stdout. The program continues from its HALT when a reader has started the bar. The extension of the file
/// selects KRL, RAPID, URScript or a TP program; in all but KRL, programs that `dbbd program` writes are executed. Exit
/// code 3: a reading at a dwell was outside the stroke.
#[derive(clap::Args)]
pub(crate) struct SimulateArgs {
    /// The program: .src of KRL, with its .dat and the modules that it calls beside it; .mod of RAPID and .ls of a FANUC,
    /// likewise; or .script of URScript.
    #[arg(long, value_name = "FILE")]
    program: PathBuf,
    /// The controller's robot: a built-in name or a file.
    #[arg(long, value_name = "NAME|FILE", default_value = EXAMPLE_ROBOT)]
    nominal: RobotName,
    /// The true robot [default: drawn from the tolerance of the nominal robot with the seed].
    #[arg(long, value_name = "TRUTH.toml")]
    robot: Option<RobotName>,
    /// The tool ball of a robot that states none, in the frame of the flange, mm: of --nominal and of --robot [default: without
    /// --nominal and --robot 30,20,10, that of the examples].
    #[arg(long, value_name = "X,Y,Z", value_parser = value::tool_ball, allow_hyphen_values = true)]
    tool: Option<[f64; 3]>,
    /// The robot with which a controller in absolute-accuracy mode ($ABS_ACCUR TRUE) computes its axis angles [default: no
    /// absolute-accuracy mode].
    #[arg(long, value_name = "NAME|FILE")]
    accuracy: Option<RobotName>,
    /// Directory for the program's .dat files as the controller leaves them, with the logged axes.
    #[arg(long, value_name = "DIR")]
    save: Option<PathBuf>,
    /// True ball centres and bar [default: those in the program's .dat]. Keys: repeatability_um (standard deviation per
    /// coordinate, default 0), backlash_deg (six, default 0), following_ms (six time constants with which the axes follow
    /// their commands, default 0), [[centre]] id, and xyz_mm or taught_deg (axis angles at which the true tool ball was
    /// there), [bar] length_mm stroke_mm noise_um (1) resolution_um (0.1) rate_hz (200) temperature_c (20).
    #[arg(long, value_name = "WORLD.toml")]
    world: Option<PathBuf>,
    /// The bar's protocol: a built-in name or a file.
    #[arg(long, value_name = "NAME|FILE", default_value = DEFAULT_PROTOCOL)]
    protocol: String,
    /// Set a parameter of the protocol, for example range_mm=50; `dbbd protocols show NAME` lists the parameters.
    #[arg(long = "param", value_name = "NAME=VALUE", value_parser = value::name_value)]
    params: Vec<(String, String)>,
    /// Serve the bar like a serial server, on tcp://ADDR:PORT or, with remote control of the line, on rfc2217://ADDR:PORT.
    /// Port number 0 selects a free one [default: a pseudo-terminal; on Windows tcp://127.0.0.1:0].
    #[arg(long, value_name = "ADDRESS")]
    listen: Option<PortAddress>,
    /// A symbolic link to the pseudo-terminal, removed at the end.
    #[cfg(unix)]
    #[arg(long, value_name = "PATH", conflicts_with = "listen")]
    link: Option<PathBuf>,
    /// The EthernetKRL server to which a program written with `krl --sync ekrl` reports its dwells.
    #[arg(long, value_name = "ADDR:PORT")]
    ekrl: Option<SocketAddr>,
    /// Publish the controller's axes: rsi://ADDR:PORT sends KUKA RSI to this address every 4 ms (UDP), rtde://ADDR:PORT serves
    /// UR RTDE (TCP). Needs a --speed other than 0, usually 1; following_ms of the world is the lag of the axes.
    #[arg(long, value_name = "ADDRESS")]
    axes: Option<AxesAddress>,
    /// Simulate a fault; may be given several times. Probabilities per byte: drop, flip, double, insert. Probabilities per
    /// frame: silence, refuse (the bar reports that it has no reading), skip (a sequence number). Others: batch_ms (bytes
    /// are held back), stale (number of bytes of an earlier stream at opening), banner=1, echo=1, wrap_ticks (until the
    /// counter wraps), drift_ppm (of the bar's clock), unplug_s, away_s (unplugged once, and back under another name; --link
    /// follows), over_mm (beyond the stroke). Of the mounting, micrometres: unseated_um (the bar rocks), creep_um (after
    /// mounting), slip_um (of a magnet, for a moment every 10 to 20 s), cable_um (the cable swings at rest). Of the packets
    /// with axes, probabilities: axes_drop, axes_double, axes_swap, axes_spoil; axes_drift_ppm (of the controller's clock),
    /// axes_delay_ms.
    #[arg(long = "fault", value_name = "NAME=VALUE", value_parser = value::name_value)]
    faults: Vec<(String, String)>,
    /// Seed of all random numbers.
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    /// Seconds of device time per second; 0: as fast as the reader takes the bytes.
    #[arg(long, value_name = "X", default_value_t = 1.0)]
    speed: f64,
    /// How long the program waits at each HALT after the bar was started, s of device time, 0 to 86400.
    #[arg(long, value_name = "S", default_value_t = 2.0)]
    halt: f64,
    /// The speed override of the controller, percent, 1 to 100.
    #[arg(long = "override", value_name = "PERCENT", default_value_t = 100.0)]
    override_percent: f64,
}

pub(crate) fn run(args: &SimulateArgs, out: &CommandOutput) -> Result<CommandOutcome, Diagnostic> {
    let ranges = [("--halt", args.halt, 0.0, 86_400.0), ("--override", args.override_percent, 1.0, 100.0)];
    for (option, value, low, high) in ranges {
        if !(low..=high).contains(&value) {
            let option = option.to_owned();
            return Err(SimulationFinding::OptionOutOfRange { option, value, low, high }.into());
        }
    }
    if args.axes.is_some() && args.speed == 0.0 {
        return Err(SimulationFinding::AxesWithoutPace.into());
    }
    if let Some(directory) = &args.save
        && files::same_place(directory, files::directory_of(&args.program))
    {
        return Err(Diagnostic::file(args.program.display(), FileFinding::IsInput));
    }
    let faults = faults(args)?;
    let definition = request::read_protocol(&args.protocol, &args.params)?;
    let mut cell = CellSimulation::new(args, &faults, out)?;
    cell.stop = stop_on_signal()?;
    let options =
        VirtualBarOptions { rate_hz: cell.world.setup().bar.rate_hz, speed: args.speed, first_ticks: 0 };
    let terminal = terminal(args)?;
    let port = terminal.address().to_string();
    out.document(&json!({ "port": port }))?;
    out.result(port);
    let bad = FaultyLine::new(faults, args.seed);
    let frames = serve_over(bad, terminal, &definition, options, &mut cell)?;
    if let Some(failure) = cell.failure {
        return Err(failure);
    }
    if cell.stop.load(Ordering::Relaxed) {
        out.finding(SimulationFinding::Stopped { dwells: cell.controller.dwells() });
        return Ok(CommandOutcome::Done);
    }
    if let Some(directory) = &args.save {
        files::directory(directory)?;
        for (path, text) in cell.controller.saved() {
            let name = Path::new(&path).file_name().unwrap_or(path.as_ref());
            files::write_file(&directory.join(name), text)?;
        }
    }
    out.progress(format!("{} dwells, {frames} frames, {:.1} s", cell.controller.dwells(), cell.program.t_s));
    if let Some(ekrl) = cell.ekrl.filter(|ekrl| !ekrl.has_reported) {
        out.finding(SimulationFinding::NoTelegram { server: ekrl.server.to_string() });
    }
    if cell.strayed > 0 {
        out.finding(SimulationFinding::OutOfStroke { readings: cell.strayed });
    }
    Ok(CommandOutcome::Done)
}

/// Opens the terminal through which the bar is read.
fn terminal(args: &SimulateArgs) -> Result<Terminal, Diagnostic> {
    let terminal = args.listen.as_ref().map_or_else(Terminal::new, Terminal::listen)?;
    #[cfg(unix)]
    if let Some(path) = &args.link {
        let link = TerminalLink::new(path, &terminal.address().to_string())?;
        return Ok(terminal.with_link(link));
    }
    Ok(terminal)
}

fn faults(args: &SimulateArgs) -> Result<InjectedFaults, Diagnostic> {
    let mut faults = InjectedFaults::default();
    for (name, value) in &args.faults {
        let Ok(number) = value.parse() else {
            let (name, value) = (name.clone(), value.clone());
            return Err(SimulationFinding::FaultNotANumber { name, value }.into());
        };
        faults.set(name, number)?;
    }
    Ok(faults)
}

/// Reads a program with the modules beside it.
fn open_program(path: &Path) -> Result<Program, Diagnostic> {
    let language = program_language(path)?;
    let directory = files::directory_of(path);
    let read = |path: &Path| Ok::<_, Diagnostic>((path.display().to_string(), files::read_text(path)?));
    let entries = || directory.read_dir().map_err(unreadable(directory.display()));
    match language {
        Language::Urscript => Ok(urscript::open(read(path)?)?.into()),
        Language::Rapid | Language::Fanuc => {
            let is_other = |other: &PathBuf| {
                let extension = other.extension().and_then(|extension| extension.to_str());
                extension.and_then(Language::of_extension) == Some(language)
                    && other.file_name() != path.file_name()
            };
            let program = read(path)?;
            let mut others: Vec<PathBuf> =
                entries()?.flatten().map(|entry| entry.path()).filter(is_other).collect();
            others.sort();
            let others = others.iter().map(|other| read(other)).collect::<Result<_, _>>()?;
            let is_rapid = language == Language::Rapid;
            Ok(if is_rapid { rapid::open(program, others) } else { fanuc::open(program, others) }?.into())
        }
        Language::Krl => {
            let stem = path.file_stem().and_then(|stem| stem.to_str()).unwrap_or_default();
            let names = entries()?.filter_map(|entry| entry.ok()?.file_name().into_string().ok());
            let names: Vec<String> = names.collect();
            let program = krl::Program::open(stem, |wanted| {
                let name = names.iter().find(|name| name.eq_ignore_ascii_case(wanted));
                name.map(|name| read(&directory.join(name))).transpose()
            })?;
            Ok(program.into())
        }
    }
}

/// A program as an artefact.
fn traced(program: &Program) -> Result<TracedArtefact, Diagnostic> {
    let Text { file, text } = program.first();
    let name = Path::new(file).file_name().unwrap_or_default().to_string_lossy();
    let artefact = Artefact::new(ArtefactRole::Program, name, text);
    Ok(TracedArtefact { artefact, provenance: provenance(file, text)? })
}

/// The axes that the controller publishes.
struct AxesOutput {
    line: AxesLine,
    publisher: AxesPublisher,
    /// The time of the next packet, s.
    next_s: f64,
}

/// The EthernetKRL server to which the program reports.
struct EkrlOutput {
    server: SocketAddr,
    /// The connection while the program has the channel open.
    client: Option<EkrlClient>,
    has_reported: bool,
}

/// What the program does at this moment of device time, and what was printed of it.
#[derive(Default)]
struct ProgramProgress {
    t_s: f64,
    halted_at_s: Option<f64>,
    done_at_s: Option<f64>,
    /// The number of dwells at the last line of progress.
    reported: u32,
}

/// The robot cell: controller, true robot and bar.
struct CellSimulation<'a> {
    controller: SimulatedController,
    world: World,
    ekrl: Option<EkrlOutput>,
    axes: Option<AxesOutput>,
    out: &'a CommandOutput,
    halt_s: f64,
    program: ProgramProgress,
    /// Readings at a strobe that were outside the stroke.
    strayed: u64,
    failure: Option<Diagnostic>,
    /// Set by a signal.
    stop: Arc<AtomicBool>,
}

impl ReadingSource for &mut CellSimulation<'_> {
    fn reading(&mut self, t_s: f64) -> Option<SimulatedReading> {
        let moment = match self.publish(t_s).and_then(|()| self.controller.step(t_s - self.program.t_s)) {
            Ok(moment) => moment,
            Err(failure) => {
                self.failure = Some(failure);
                return None;
            }
        };
        self.program.t_s = t_s;
        if let Err(failure) = self.exchange() {
            self.failure = Some(failure);
            return None;
        }
        self.report(&moment);
        if moment.halted {
            let since = *self.program.halted_at_s.get_or_insert(t_s);
            if t_s - since >= self.halt_s {
                self.program.halted_at_s = None;
                self.controller.go_on();
            }
        }
        if moment.done && t_s - *self.program.done_at_s.get_or_insert(t_s) > AFTER_END_S {
            return None;
        }
        let measured = self.world.reading(&moment);
        let valid = measured.in_stroke;
        self.strayed += u64::from(moment.strobe && !valid);
        let temperature_c = self.world.setup().bar.temperature_c;
        Some(SimulatedReading {
            reading_mm: measured.reading_mm,
            strobe: moment.strobe,
            valid,
            temperature_c,
        })
    }

    fn over(&self) -> bool {
        self.program.done_at_s.is_some()
    }

    fn is_stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }
}

impl<'a> CellSimulation<'a> {
    fn new(args: &SimulateArgs, faults: &InjectedFaults, out: &'a CommandOutput) -> Result<Self, Diagnostic> {
        let LoadedRobot { robot: nominal, source, .. } = robots::read_named_robot(&args.nominal, out)?;
        let is_example = *args.nominal == *EXAMPLE_ROBOT && args.robot.is_none();
        let tool_mm = args.tool.or(is_example.then_some(EXAMPLE_TOOL_MM));
        let with_tool = |robot: Robot| match tool_mm.filter(|_| !robot.has_tool) {
            Some(tool_mm) => robot.with_tool(tool_mm),
            None => robot,
        };
        let nominal = with_tool(nominal);
        let robot = match &args.robot {
            Some(name) => with_tool(robots::named(name, out)?),
            None => truth::draw_true_robot(&nominal, args.seed, 1.0),
        };
        let program = open_program(&args.program)?;
        traced(&program)?.check_made_for(&source.artefact)?;
        robot.check_tool()?;
        let world_text = args.world.as_deref().map(files::read_text).transpose()?;
        let world_name = args.world.as_ref().map(|path| path.display().to_string());
        let setup = WorldSetup::new(&program.setups(), world_name.as_deref().zip(world_text.as_deref()))?;
        let accuracy = args.accuracy.as_ref().map(|name| robots::named(name, out)).transpose()?;
        let mut controller =
            SimulatedController::new(program, accuracy.as_ref().unwrap_or(&nominal), args.override_percent)?;
        if accuracy.is_some() {
            controller.set_absolute_accuracy();
        }
        if args.ekrl.is_some() {
            controller.link_ekrl();
        }
        let axes = args.axes.as_ref().map(|address| -> Result<AxesOutput, Diagnostic> {
            let line = AxesLine::open(address)?;
            let publisher = AxesPublisher::new(line.protocol(), faults, args.seed, FIRST_TICKS);
            Ok(AxesOutput { line, publisher, next_s: 0.0 })
        });
        Ok(Self {
            controller,
            world: World::new(robot.geometry, setup, args.seed),
            ekrl: args.ekrl.map(|server| EkrlOutput { server, client: None, has_reported: false }),
            axes: axes.transpose()?,
            out,
            halt_s: args.halt,
            program: ProgramProgress::default(),
            strayed: 0,
            failure: None,
            stop: Arc::default(),
        })
    }

    /// Steps the controller through the publishing cycles up to a time, s, and publishes the axes in each.
    fn publish(&mut self, until_s: f64) -> Result<(), Diagnostic> {
        let Some(axes) = &mut self.axes else { return Ok(()) };
        while axes.next_s <= until_s {
            let moment = self.controller.step(axes.next_s - self.program.t_s)?;
            self.program.t_s = axes.next_s;
            let measured = self.world.measured(&moment);
            axes.publisher.cycle(self.program.t_s, &measured, &moment.axes);
            while let Some(packet) = axes.publisher.arrived(self.program.t_s) {
                axes.line.send(&packet);
            }
            axes.next_s += axes.line.cycle_s() / axes.publisher.pace();
        }
        Ok(())
    }

    /// Sends the controller's telegrams to the server and hands over the answers. Device time does not advance meanwhile.
    fn exchange(&mut self) -> Result<(), Diagnostic> {
        let Some(EkrlOutput { server, client, has_reported }) = &mut self.ekrl else { return Ok(()) };
        if !self.controller.ekrl_open() {
            *client = None;
            return Ok(());
        }
        let client = match client {
            Some(client) => client,
            None => client.insert(EkrlClient::connect(*server)?),
        };
        while let Some(telegram) = self.controller.telegram() {
            *has_reported = true;
            self.controller.answer(client.exchange(&telegram)?);
        }
        Ok(())
    }

    /// Prints each HALT, the end, and every tenth dwell.
    fn report(&mut self, moment: &ControllerMoment) {
        let dwells = self.controller.dwells();
        let (file, line) = self.controller.position();
        if moment.halted && self.program.halted_at_s.is_none() {
            self.out.progress(format!("{file}:{line}: HALT"));
        }
        if moment.done && self.program.done_at_s.is_none() {
            self.out.progress(format!("the program has ended after {dwells} dwells"));
        }
        if dwells >= self.program.reported + 10 {
            self.program.reported = dwells;
            self.out.progress(format!("{file}:{line}: {dwells} dwells done"));
        }
    }
}
