//! Servers of one test: PostgreSQL in a temporary directory, an S3 store, and lines to them that can be cut. A test fails
//! where one of them is not installed.

use std::ffi::OsString;
use std::fs;
use std::io::{Read, Write};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::os::unix::fs::{MetadataExt as _, chown};
use std::os::unix::process::CommandExt as _;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU8, Ordering};
use std::time::Duration;

use dbbd_device::clock;
use postgres::{Client, NoTls};
use tempfile::TempDir;

/// A program in the search path, or where Debian keeps those of PostgreSQL.
pub(crate) fn program(name: &str) -> PathBuf {
    let path = std::env::var_os("PATH").unwrap_or_default();
    let debian = fs::read_dir("/usr/lib/postgresql").into_iter().flatten().flatten();
    let debian: Vec<PathBuf> = debian.map(|version| version.path().join("bin")).collect();
    let mut places = std::env::split_paths(&path).chain(debian).map(|dir| dir.join(name));
    places.find(|path| path.is_file()).unwrap_or_else(|| panic!("{name} is not installed"))
}

fn free_port() -> u16 {
    TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port()
}

/// PostgreSQL with its data in a directory of its own.
pub(crate) struct Cluster {
    dir: TempDir,
    server: Child,
    pub(crate) port: u16,
}

/// PostgreSQL refuses to run as root: the ids of another user.
fn user() -> Option<(u32, u32)> {
    if fs::metadata("/proc/self").unwrap().uid() != 0 {
        return None;
    }
    let users = fs::read_to_string("/etc/passwd").unwrap();
    let of = |name: &str| users.lines().find(|line| line.starts_with(&format!("{name}:")));
    let fields: Vec<&str> = of("postgres").or_else(|| of("nobody")).unwrap().split(':').collect();
    Some((fields[2].parse().unwrap(), fields[3].parse().unwrap()))
}

fn as_user(program: &Path) -> Command {
    let mut command = Command::new(program);
    if let Some((user, group)) = user() {
        command.uid(user).gid(group);
    }
    command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null()).current_dir("/");
    command
}

impl Cluster {
    /// A cluster whose superuser `postgres` needs no password; `prepare` may add files and lines of configuration.
    pub(crate) fn new(prepare: impl FnOnce(&Path) -> String) -> Self {
        let dir = tempfile::tempdir().unwrap();
        let give = |path: &Path| user().iter().for_each(|own| chown(path, Some(own.0), Some(own.1)).unwrap());
        give(dir.path());
        let data = dir.path().join("data");
        let mut init = as_user(&program("initdb"));
        init.args(["-U", "postgres", "-A", "trust", "-E", "UTF8", "--no-locale", "-N", "-D"]).arg(&data);
        assert!(init.status().unwrap().success());
        let more = prepare(&data);
        fs::read_dir(&data).unwrap().for_each(|entry| give(&entry.unwrap().path()));
        let own = format!("listen_addresses = '127.0.0.1'\nunix_socket_directories = ''\n{more}");
        let mut configuration =
            fs::OpenOptions::new().append(true).open(data.join("postgresql.conf")).unwrap();
        configuration.write_all(own.as_bytes()).unwrap();
        let port = free_port();
        Self { server: Self::spawn(&data, port), dir, port }
    }

    fn spawn(data: &Path, port: u16) -> Child {
        as_user(&program("postgres")).arg("-D").arg(data).args(["-p", &port.to_string()]).spawn().unwrap()
    }

    /// Kills the server (SIGKILL) and starts it again on its data.
    pub(crate) fn kill_and_start(&mut self) {
        self.server.kill().unwrap();
        self.server.wait().unwrap();
        self.server = Self::spawn(&self.dir.path().join("data"), self.port);
    }

    pub(crate) fn address(&self, role: &str, database: &str) -> String {
        format!("postgres://{role}@127.0.0.1:{}/{database}", self.port)
    }

    /// Waits until it answers. A server that finds the processes of one that was killed ends again: it is started
    /// again.
    pub(crate) fn client(&mut self, database: &str) -> Client {
        for _ in 0..600 {
            if self.server.try_wait().unwrap().is_some() {
                self.server = Self::spawn(&self.dir.path().join("data"), self.port);
            }
            if let Ok(client) = Client::connect(&self.address("postgres", database), NoTls) {
                return client;
            }
            clock::sleep(0.05);
        }
        panic!("PostgreSQL does not start");
    }
}

impl Drop for Cluster {
    fn drop(&mut self) {
        // SIGQUIT ends its processes at once, too.
        let _ = Command::new("kill").args(["-QUIT", &self.server.id().to_string()]).status();
        let _ = self.server.wait();
    }
}

/// The S3 store of `moto_server` (Python package `moto[server]`; DBBD_TEST_MOTO names it), with the bucket `dbbd`.
pub(crate) struct S3 {
    server: Child,
    pub(crate) port: u16,
}

impl S3 {
    pub(crate) fn new() -> Self {
        let named = std::env::var_os("DBBD_TEST_MOTO").map(PathBuf::from);
        let port = free_port();
        let mut command = Command::new(named.unwrap_or_else(|| program("moto_server")));
        command
            .args(["-H", "127.0.0.1", "-p", &port.to_string()])
            .stdout(Stdio::null())
            .stderr(Stdio::null());
        let s3 = Self { server: command.spawn().unwrap(), port };
        for _ in 0..600 {
            if s3.ask("PUT", "/dbbd") == Some(200) {
                return s3;
            }
            clock::sleep(0.1);
        }
        panic!("moto_server does not start");
    }

    /// The status of its answer.
    pub(crate) fn ask(&self, method: &str, path: &str) -> Option<u16> {
        let mut stream = TcpStream::connect(("127.0.0.1", self.port)).ok()?;
        let head = format!(
            "{method} {path} HTTP/1.1\r\nHost: 127.0.0.1:{}\r\nContent-Length: 0\r\nConnection: close\r\n\r\n",
            self.port
        );
        stream.write_all(head.as_bytes()).ok()?;
        let mut answer = Vec::new();
        let _ = stream.read_to_end(&mut answer);
        String::from_utf8_lossy(&answer).split(' ').nth(1)?.parse().ok()
    }
}

impl Drop for S3 {
    fn drop(&mut self) {
        let _ = self.server.kill();
        let _ = self.server.wait();
    }
}

/// What a line does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub(crate) enum Fault {
    None,
    /// Connections end in the middle of what they carry, and no new one is let in.
    Cut,
    /// Each request is answered by a status 500.
    Status500,
}

/// A proxy for a port of this computer.
pub(crate) struct Line {
    pub(crate) port: u16,
    fault: Arc<AtomicU8>,
    over: Arc<AtomicBool>,
}

impl Line {
    pub(crate) fn to(target: u16) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let port = listener.local_addr().unwrap().port();
        let line = Self { port, fault: Arc::default(), over: Arc::default() };
        let (fault, over) = (Arc::clone(&line.fault), Arc::clone(&line.over));
        std::thread::spawn(move || {
            for stream in listener.incoming().map_while(Result::ok) {
                if over.load(Ordering::Relaxed) {
                    return;
                }
                let fault = Arc::clone(&fault);
                std::thread::spawn(move || pass(stream, target, &fault));
            }
        });
        line
    }

    pub(crate) fn set(&self, fault: Fault) {
        self.fault.store(fault as u8, Ordering::Relaxed);
    }
}

impl Drop for Line {
    fn drop(&mut self) {
        self.over.store(true, Ordering::Relaxed);
        let _ = TcpStream::connect(("127.0.0.1", self.port));
    }
}

fn pass(mut client: TcpStream, target: u16, fault: &Arc<AtomicU8>) {
    let now = fault.load(Ordering::Relaxed);
    if now == Fault::Status500 as u8 {
        client.set_read_timeout(Some(Duration::from_millis(50))).unwrap();
        let _ = client.read(&mut [0; 4096]);
        let answer = "HTTP/1.1 500 Internal Server Error\r\nContent-Length: 0\r\nConnection: close\r\n\r\n";
        let _ = client.write_all(answer.as_bytes());
        return;
    }
    if now == Fault::Cut as u8 {
        return;
    }
    let Ok(server) = TcpStream::connect(("127.0.0.1", target)) else { return };
    let other = (client.try_clone().unwrap(), server.try_clone().unwrap());
    let shared = Arc::clone(fault);
    let back = std::thread::spawn(move || carry(other.1, other.0, &shared));
    carry(client, server, fault);
    let _ = back.join();
}

/// Carries bytes until an end closes or the line has a fault: then half of a piece still goes.
fn carry(mut from: TcpStream, mut to: TcpStream, fault: &AtomicU8) {
    from.set_read_timeout(Some(Duration::from_millis(20))).unwrap();
    let mut piece = [0; 1500];
    loop {
        let faulty = || fault.load(Ordering::Relaxed) != Fault::None as u8;
        let read = match from.read(&mut piece) {
            Ok(0) => break,
            Ok(read) => read,
            Err(error)
                if matches!(error.kind(), std::io::ErrorKind::WouldBlock | std::io::ErrorKind::TimedOut) =>
            {
                if faulty() {
                    break;
                }
                continue;
            }
            Err(_) => break,
        };
        let passed = if faulty() { read / 2 } else { read };
        if to.write_all(&piece[..passed]).is_err() || faulty() {
            break;
        }
    }
    let _ = from.shutdown(Shutdown::Both);
    let _ = to.shutdown(Shutdown::Both);
}

/// Runs a program to its end.
pub(crate) fn run(program: &Path, args: &[OsString]) -> bool {
    let output = Command::new(program).args(args).output().unwrap();
    if !output.status.success() {
        eprintln!("{}: {}", program.display(), String::from_utf8_lossy(&output.stderr));
    }
    output.status.success()
}

/// Copies what is in a directory into another.
pub(crate) fn copy_directory(from: &Path, to: &Path) {
    fs::create_dir_all(to).unwrap();
    assert!(run(Path::new("cp"), &["-a".into(), from.join(".").into(), to.into()]));
}
