//! The mark of a simulated bar. No protocol has a field for "this is simulated", so the virtual bar sends a line of text
//! before the first bytes of each stream, and a port takes it out of what it reads: it is no data of a bar.

use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use super::line::{PortLine, StampAccuracy};

/// What a virtual bar sends first. Its length excludes that a real bar sends it by chance.
pub const SIMULATED_MARK: &[u8] = b"dbbd simulate: not a real bar\r\n";
/// Bytes after the opening in which the mark is looked for: more than a line holds of an earlier stream.
const MAX_BEFORE: usize = 64 << 10;

/// A line without the mark that may be in its first bytes.
pub(super) struct UnmarkedLine {
    line: Box<dyn PortLine>,
    is_simulated: Arc<AtomicBool>,
    /// The last bytes that were read, if they may be the begin of the mark.
    held: Vec<u8>,
    read: usize,
}

impl UnmarkedLine {
    pub(super) fn new(line: Box<dyn PortLine>) -> Self {
        Self { line, is_simulated: Arc::default(), held: Vec::new(), read: 0 }
    }

    /// Takes the marks out of the first `count` bytes of `room`. Returns how many of them are to be given on.
    fn unmark(&mut self, room: &mut [u8], mut count: usize) -> usize {
        let marked =
            |bytes: &[u8]| bytes.windows(SIMULATED_MARK.len()).position(|part| part == SIMULATED_MARK);
        while let Some(at) = marked(&room[..count]) {
            self.is_simulated.store(true, Ordering::Relaxed);
            room.copy_within(at + SIMULATED_MARK.len()..count, at);
            count -= SIMULATED_MARK.len();
        }
        let bytes = &room[..count];
        let longest = SIMULATED_MARK.len().min(count + 1);
        let begun = (1..longest).rev().find(|len| bytes.ends_with(&SIMULATED_MARK[..*len])).unwrap_or(0);
        self.held.extend(&bytes[count - begun..]);
        count - begun
    }
}

impl PortLine for UnmarkedLine {
    fn read(&mut self, room: &mut [u8]) -> io::Result<usize> {
        // A simulated bar marks each of its streams.
        let is_real = self.read > MAX_BEFORE && !self.is_simulated();
        if is_real || room.len() <= SIMULATED_MARK.len() {
            return self.line.read(room);
        }
        let held = std::mem::take(&mut self.held);
        room[..held.len()].copy_from_slice(&held);
        match self.line.read(&mut room[held.len()..]) {
            Ok(0) if held.is_empty() => Ok(0),
            Ok(count) if count > 0 => {
                self.read += count;
                match self.unmark(room, held.len() + count) {
                    // The rest of the mark may follow: there is nothing to read yet.
                    0 => Err(io::ErrorKind::Interrupted.into()),
                    count => Ok(count),
                }
            }
            // It was no begin of the mark.
            Ok(_) | Err(_) if !held.is_empty() => {
                self.read = MAX_BEFORE + 1;
                Ok(held.len())
            }
            other => other,
        }
    }

    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.line.write(bytes)
    }

    fn set_timeout(&mut self, timeout: Duration) -> io::Result<()> {
        self.line.set_timeout(timeout)
    }

    fn set_baud(&mut self, baud: u32) -> io::Result<()> {
        self.line.set_baud(baud)
    }

    fn set_dtr(&mut self, level: bool) -> io::Result<()> {
        self.line.set_dtr(level)
    }

    fn handle(&self) -> io::Result<Box<dyn PortLine>> {
        let Self { line, is_simulated, held, read } = self;
        let (line, is_simulated) = (line.handle()?, Arc::clone(is_simulated));
        Ok(Box::new(Self { line, is_simulated, held: held.clone(), read: *read }))
    }

    fn stamps(&self) -> StampAccuracy {
        self.line.stamps()
    }

    fn is_simulated(&self) -> bool {
        self.is_simulated.load(Ordering::Relaxed)
    }

    fn is_plain_telnet(&self) -> bool {
        self.line.is_plain_telnet()
    }
}

#[cfg(test)]
mod tests {
    use std::collections::VecDeque;

    use super::*;
    use crate::port::LineTransport;

    /// A line that gives the bytes of one chunk in each read, and then times out.
    struct Chunks(VecDeque<Vec<u8>>);

    impl PortLine for Chunks {
        fn read(&mut self, room: &mut [u8]) -> io::Result<usize> {
            let chunk = self.0.pop_front().ok_or(io::ErrorKind::TimedOut)?;
            room[..chunk.len()].copy_from_slice(&chunk);
            Ok(chunk.len())
        }
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            Ok(bytes.len())
        }
        fn set_timeout(&mut self, _: Duration) -> io::Result<()> {
            Ok(())
        }
        fn set_baud(&mut self, _: u32) -> io::Result<()> {
            Ok(())
        }
        fn set_dtr(&mut self, _: bool) -> io::Result<()> {
            Ok(())
        }
        fn handle(&self) -> io::Result<Box<dyn PortLine>> {
            Err(io::ErrorKind::Unsupported.into())
        }
        fn stamps(&self) -> StampAccuracy {
            StampAccuracy { transport: LineTransport::Pty, held_ms: None }
        }
    }

    /// What is read of the chunks, and whether the line is simulated.
    fn read(chunks: &[&[u8]]) -> (Vec<u8>, bool) {
        let chunks: VecDeque<_> = chunks.iter().map(|chunk| chunk.to_vec()).collect();
        let mut line = UnmarkedLine::new(Box::new(Chunks(chunks)));
        let (mut all, mut room) = (Vec::new(), [0; 256]);
        loop {
            match line.read(&mut room) {
                Ok(count) => all.extend(&room[..count]),
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(_) => return (all, line.is_simulated()),
            }
        }
    }

    #[test]
    fn the_mark_is_taken_out_however_it_is_cut() {
        for cut in 0..=SIMULATED_MARK.len() {
            let (one, two) = SIMULATED_MARK.split_at(cut);
            let chunks = [[b"stale dbb", one].concat(), [two, b"1.234\r\n"].concat(), b"dbbd".to_vec()];
            let chunks: Vec<&[u8]> = chunks.iter().map(Vec::as_slice).collect();
            assert_eq!(read(&chunks), (b"stale dbb1.234\r\ndbbd".to_vec(), true), "{cut}");
        }
        let bytewise: Vec<&[u8]> = SIMULATED_MARK.chunks(1).chain([&b"x"[..]]).collect();
        assert_eq!(read(&bytewise), (b"x".to_vec(), true));
        // A bar that is stopped and started again marks both streams.
        let twice = [SIMULATED_MARK, b"1\r\n", SIMULATED_MARK, b"2\r\n"];
        let all = (b"1\r\n2\r\n".to_vec(), true);
        assert_eq!(read(&twice), all);
        assert_eq!(read(&[&twice.concat()]), all);
    }

    #[test]
    fn a_real_bar_loses_no_byte() {
        let text = b"dbbd simulate: not a real baR\r\n".to_vec();
        assert_eq!(read(&[&text]), (text.clone(), false));
        let bytewise: Vec<&[u8]> = text.chunks(1).collect();
        assert_eq!(read(&bytewise), (text.clone(), false));
        assert_eq!(read(&[b"1.0 d", b"bb"]), (b"1.0 dbb".to_vec(), false));
    }

    /// Later bytes are given on at once: no byte of a running bar waits for the next.
    #[test]
    fn the_mark_is_only_looked_for_in_the_first_bytes() {
        let chunk = [b'x'; 128];
        let mut chunks = vec![&chunk[..]; MAX_BEFORE / 128 + 1];
        chunks.push(SIMULATED_MARK);
        let (all, is_simulated) = read(&chunks);
        assert_eq!(
            (all.len(), is_simulated),
            (chunk.len() * (chunks.len() - 1) + SIMULATED_MARK.len(), false)
        );
        chunks.drain(..2);
        assert!(read(&chunks).1);
    }
}
