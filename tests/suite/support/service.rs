//! Test support: a `dbbd serve` process and a client that sends given bytes.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use dbbd_device::clock;
use serde_json::Value;

/// The service as a child process.
pub(crate) struct Server {
    pub(crate) child: Child,
    pub(crate) address: SocketAddr,
    log: Arc<Mutex<Vec<String>>>,
}

/// An answer.
#[derive(Debug)]
pub(crate) struct Answer {
    pub(crate) status: u16,
    pub(crate) head: String,
    pub(crate) body: Vec<u8>,
}

impl Answer {
    pub(crate) fn json(&self) -> Value {
        serde_json::from_slice(&self.body).unwrap_or_else(|error| panic!("{error}: {self:?}"))
    }
}

impl Server {
    /// Starts the service in `dir` on a free port. `config` follows the address in its configuration.
    pub(crate) fn start(dir: &Path, config: &str) -> Self {
        Self::start_at(dir, "127.0.0.1:0", config)
    }

    pub(crate) fn start_at(dir: &Path, address: &str, config: &str) -> Self {
        Self::start_program(Path::new(env!("CARGO_BIN_EXE_dbbd")), dir, address, config)
    }

    /// The same with another executable.
    pub(crate) fn start_program(program: &Path, dir: &Path, address: &str, config: &str) -> Self {
        std::fs::write(dir.join("dbbd.toml"), format!("address = \"{address}\"\n{config}")).unwrap();
        let mut command = Command::new(program);
        command.env("DBBD_TEST_SECRET", "secret").args(["serve", "--config", "dbbd.toml"]).current_dir(dir);
        Self::start_command(command)
    }

    /// Starts a command that logs its address.
    pub(crate) fn start_command(mut command: Command) -> Self {
        let mut child = command.stdin(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
        let mut lines = BufReader::new(child.stderr.take().unwrap()).lines();
        let listening = lines.by_ref().map(Result::unwrap).find(|line| line.contains("event=listening"));
        let listening = listening.expect("the service listens");
        let (_, address) = listening.split_once("http://").unwrap();
        let port = address.trim_end_matches(['/', '"']).rsplit_once(':').unwrap().1.parse().unwrap();
        // Read the whole log, so that the process never blocks on it.
        let log = Arc::new(Mutex::new(Vec::new()));
        let kept = Arc::clone(&log);
        std::thread::spawn(move || {
            lines.map_while(Result::ok).for_each(|line| kept.lock().unwrap().push(line))
        });
        Self { child, address: SocketAddr::from(([127, 0, 0, 1], port)), log }
    }

    /// The lines of an event; a thread reads them, so the first may take a moment.
    pub(crate) fn logged(&self, event: &str) -> Vec<String> {
        let wanted = format!("event={event} ");
        let lines = || -> Vec<String> {
            self.log.lock().unwrap().iter().filter(|line| line.contains(&wanted)).cloned().collect()
        };
        let come = (0..20).map(|_| lines()).find(|lines| {
            !lines.is_empty() || {
                clock::sleep(0.05);
                false
            }
        });
        come.unwrap_or_default()
    }

    pub(crate) fn connect(&self) -> TcpStream {
        let stream = TcpStream::connect(self.address).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
        stream
    }

    /// Sends bytes and reads the answer until the service closes.
    pub(crate) fn raw(&self, request: &[u8]) -> Answer {
        let mut stream = self.connect();
        // The service may refuse a request before it has read all of it.
        let _ = stream.write_all(request);
        let mut bytes = Vec::new();
        let _ = stream.read_to_end(&mut bytes);
        let end = bytes.windows(4).position(|four| four == b"\r\n\r\n").map_or(bytes.len(), |at| at + 4);
        let head = String::from_utf8_lossy(&bytes[..end]).into_owned();
        let status = head.split(' ').nth(1).and_then(|status| status.parse().ok()).unwrap_or(0);
        Answer { status, head, body: bytes[end..].to_vec() }
    }

    /// A request with further header lines, each ended by CR LF.
    pub(crate) fn ask(&self, method: &str, path: &str, headers: &str, body: &str) -> Answer {
        let host = self.address;
        let head = format!("{method} {path} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n{headers}");
        self.raw(format!("{head}Content-Length: {}\r\n\r\n{body}", body.len()).as_bytes())
    }

    pub(crate) fn get(&self, path: &str) -> Answer {
        self.ask("GET", path, "", "")
    }

    pub(crate) fn post(&self, path: &str, body: &str) -> Answer {
        self.ask("POST", path, "Content-Type: application/json\r\n", body)
    }

    /// Repeats a request until the answer satisfies the condition.
    pub(crate) fn wait(&self, path: &str, wanted: impl Fn(&Value) -> bool) -> Value {
        for _ in 0..600 {
            let answer = self.get(path).json();
            if wanted(&answer) {
                return answer;
            }
            clock::sleep(0.05);
        }
        panic!("{path} does not become what is waited for: {}", self.get(path).json());
    }

    /// Sends a signal by the system's own tool, and waits for the end.
    pub(crate) fn signal(&mut self, name: &str) -> Option<i32> {
        let id = self.child.id().to_string();
        assert!(Command::new("kill").args([format!("-{name}"), id]).status().unwrap().success());
        self.child.wait().unwrap().code()
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
