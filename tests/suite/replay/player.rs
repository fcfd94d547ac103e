//! Plays the bar's part of a recording, in a process of its own: a terminal that another test's child had
//! inherited would not hang up when it is unplugged.

use std::io::{ErrorKind, Read, Write};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use dbbd_device::clock;
use dbbd_job::sim::bar::TerminalLink;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use serialport::{SerialPort, TTYPort};

use super::received;
use crate::recordings::{Line, Recording, What, all};

/// How long the other side is waited for, s.
pub(super) const PATIENCE_S: f64 = 20.0;

/// How the bar's bytes are cut into pieces.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Cuts {
    /// As they came.
    Recorded,
    Bytes,
    /// All that comes between two words of the host.
    Whole,
    /// Anywhere, by a seed.
    Seeded(u64),
    /// As they came; the bar is unplugged somewhere, by a seed, and comes back under another name.
    Unplugged(u64),
}

impl Cuts {
    /// As a process is told it.
    fn word(self) -> (&'static str, u64) {
        match self {
            Cuts::Recorded => ("recorded", 0),
            Cuts::Bytes => ("bytes", 0),
            Cuts::Whole => ("whole", 0),
            Cuts::Seeded(seed) => ("seeded", seed),
            Cuts::Unplugged(seed) => ("unplugged", seed),
        }
    }

    fn of(word: &str, seed: u64) -> Self {
        match word {
            "recorded" => Cuts::Recorded,
            "bytes" => Cuts::Bytes,
            "whole" => Cuts::Whole,
            "seeded" => Cuts::Seeded(seed),
            _ => Cuts::Unplugged(seed),
        }
    }
}

/// Runs a test of this binary in a process of its own; what it is told stands in an environment variable.
pub(super) fn other_side(test: &str, told: &str) -> Child {
    let mut command = Command::new(std::env::current_exe().unwrap());
    command.args(["--exact", test, "--ignored", "--nocapture"]).env("DBBD_OTHER_SIDE", told);
    command.stdin(Stdio::piped()).stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap()
}

/// What this process is told, where it is the other side of a test.
pub(super) fn told() -> Option<Vec<String>> {
    Some(std::env::var("DBBD_OTHER_SIDE").ok()?.split('\t').map(str::to_owned).collect())
}

/// Starts to play a recording behind the link; it says `ready`.
pub(super) fn start(recording: &Recording, cuts: Cuts, link: &str) -> Child {
    let (word, seed) = cuts.word();
    other_side("replay::player::plays", &format!("{}\t{word}\t{seed}\t{link}", recording.name))
}

#[test]
#[ignore = "the other side of a replay, which starts it"]
fn plays() {
    let Some(told) = told() else { return };
    let [name, word, seed, link] = &told[..] else { panic!("{told:?}") };
    let recording = all().into_iter().find(|recording| recording.name == *name).unwrap();
    let mut player = Player::new(link);
    eprintln!("ready");
    // A line on stdin says that the program reads, its end that it is over.
    let (reads, over) = (Arc::clone(&player.reads), Arc::new(AtomicBool::new(false)));
    let ended = Arc::clone(&over);
    std::thread::spawn(move || {
        let _ = std::io::stdin().read_line(&mut String::new());
        reads.store(true, Ordering::Relaxed);
        let _ = std::io::stdin().read_line(&mut String::new());
        ended.store(true, Ordering::Relaxed);
    });
    player.play(&recording, Cuts::of(word, seed.parse().unwrap()));
    while !over.load(Ordering::Relaxed) {
        player.listen();
    }
}

fn pieces(recording: &Recording, cuts: Cuts) -> Vec<What> {
    if let Cuts::Unplugged(seed) = cuts {
        return unplugged(recording, seed);
    }
    let mut dice = Pcg64::seed_from_u64(if let Cuts::Seeded(seed) = cuts { seed } else { 0 });
    let mut pieces: Vec<What> = Vec::new();
    for line in &recording.lines {
        match (&line.what, cuts) {
            (What::Bar(bytes), Cuts::Bytes) => {
                pieces.extend(bytes.chunks(1).map(|one| What::Bar(one.into())));
            }
            (What::Bar(bytes), Cuts::Whole) => match pieces.last_mut() {
                Some(What::Bar(before)) => before.extend(bytes),
                _ => pieces.push(What::Bar(bytes.clone())),
            },
            (What::Bar(bytes), Cuts::Seeded(_)) => {
                let mut rest = &bytes[..];
                while !rest.is_empty() {
                    let (piece, tail) = rest.split_at(dice.random_range(1..=rest.len()));
                    pieces.push(What::Bar(piece.into()));
                    rest = tail;
                }
            }
            (what, _) => pieces.push(what.clone()),
        }
    }
    pieces
}

/// Unplugged behind some piece of the stream; then the host opens the bar again as at the beginning.
fn unplugged(recording: &Recording, seed: u64) -> Vec<What> {
    let mut dice = Pcg64::seed_from_u64(seed);
    let what = |line: &Line| line.what.clone();
    let (opening, rest) = recording.lines.split_at(recording.opening());
    // Not between a request and its answer: that would come before the bar is asked again.
    let polled = !recording.definition().poll.is_empty();
    let may = |pair: &[Line]| {
        matches!(pair[0].what, What::Bar(_)) && (!polled || matches!(pair[1].what, What::Host(_)))
    };
    let said: Vec<usize> =
        rest.windows(2).enumerate().filter(|(_, pair)| may(pair)).map(|(at, _)| at).collect();
    let (before, behind) = rest.split_at(said[dice.random_range(0..said.len())] + 1);
    let again = [What::Unplugged].into_iter().chain(opening.iter().map(what));
    opening.iter().chain(before).map(what).chain(again).chain(behind.iter().map(what)).collect()
}

/// Number of bytes of the stream; each time that it is plugged in, the bar is opened with `opening` pieces, which are not
/// of the stream.
fn stream(plugged_in: &[What], opening: usize) -> usize {
    let said =
        plugged_in.split(|piece| *piece == What::Unplugged).flat_map(|pieces| pieces.iter().skip(opening));
    said.map(|piece| if let What::Bar(bytes) = piece { bytes.len() } else { 0 }).sum()
}

struct Player {
    line: TTYPort,
    link: String,
    plug: Option<TerminalLink>,
    heard: Vec<u8>,
    /// Whether the program has said that it reads.
    reads: Arc<AtomicBool>,
}

/// A terminal behind a link.
pub(super) fn terminal(link: &str) -> (TTYPort, TerminalLink) {
    let (mut line, host) = TTYPort::pair().unwrap();
    line.set_timeout(Duration::from_millis(1)).unwrap();
    (line, TerminalLink::new(Path::new(link), &host.name().unwrap()).unwrap())
}

impl Player {
    fn new(link: &str) -> Self {
        let (line, plug) = terminal(link);
        Self { line, link: link.into(), plug: Some(plug), heard: Vec::new(), reads: Arc::default() }
    }

    fn play(&mut self, recording: &Recording, cuts: Cuts) {
        let settle_s = recording.definition().line.settle.as_secs_f64();
        let (pieces, opening) = (pieces(recording, cuts), recording.opening());
        let mut spoken_to = false;
        for (at, what) in pieces.iter().enumerate() {
            match what {
                What::Host(word) => {
                    spoken_to = true;
                    self.wait(|player| player.heard.starts_with(word));
                    self.heard.drain(..word.len().min(self.heard.len()));
                }
                What::Bar(bytes) => {
                    // Nothing that the host says tells that it has opened the line.
                    if !spoken_to {
                        self.wait(|player| player.reads.load(Ordering::Relaxed));
                        spoken_to = true;
                    }
                    self.say(bytes);
                }
                What::Unplugged => {
                    // A terminal throws away what nobody has read yet.
                    let before = recording.stream - stream(&pieces[at + 1..], opening);
                    let run = Path::new(&self.link).with_file_name("run").display().to_string();
                    let begun = clock::now();
                    while received(&run) < before && clock::now().seconds_since(begun) < PATIENCE_S {
                        clock::sleep(0.01);
                    }
                    drop(self.plug.take());
                    // The new one is made before the old one goes: it has another name then.
                    let (line, plug) = terminal(&self.link);
                    (self.line, self.plug) = (line, Some(plug));
                    self.heard.clear();
                    self.wait_for_the_host(settle_s);
                }
            }
        }
    }

    fn wait(&mut self, come: impl Fn(&Self) -> bool) {
        let begun = clock::now();
        while !come(self) && clock::now().seconds_since(begun) < PATIENCE_S {
            self.listen();
        }
    }

    /// The host opens the line again; one that never says a word reads when the line has settled.
    fn wait_for_the_host(&mut self, settle_s: f64) {
        let begun = clock::now();
        while read(&mut self.line).map(|bytes| self.heard.extend(bytes)).is_none()
            && clock::now().seconds_since(begun) < PATIENCE_S
        {
            clock::sleep(0.002);
        }
        let opened = clock::now();
        while self.heard.is_empty() && clock::now().seconds_since(opened) < settle_s + 1.0 {
            self.listen();
        }
    }

    fn listen(&mut self) {
        match read(&mut self.line) {
            Some(bytes) => self.heard.extend(bytes),
            // Nobody has opened it: reading fails at once.
            None => clock::sleep(0.002),
        }
    }

    fn say(&mut self, bytes: &[u8]) {
        let mut rest = bytes;
        while !rest.is_empty() {
            match self.line.write(rest) {
                Ok(count) => rest = &rest[count..],
                Err(error) if error.kind() == ErrorKind::TimedOut => {}
                Err(error) => panic!("{error}"),
            }
        }
    }
}

/// What is there; none when the other side is gone.
pub(super) fn read(line: &mut TTYPort) -> Option<Vec<u8>> {
    let mut buffer = [0; 4096];
    match line.read(&mut buffer) {
        Ok(0) => None,
        Ok(count) => Some(buffer[..count].to_vec()),
        Err(error) if matches!(error.kind(), ErrorKind::TimedOut | ErrorKind::Interrupted) => {
            Some(Vec::new())
        }
        Err(_) => None,
    }
}
