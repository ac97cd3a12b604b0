//! What a stream has not taken yet: whole packets, a bounded number of bytes.

use std::io::{self, Write};

use super::Sent;

/// As much as a radio of 57,600 baud sends in a second and a half: what is older
/// is better dropped than sent.
const WAITING_MAX_BYTES: usize = 8 << 10;

/// Bytes that wait for a stream to take them.
#[derive(Debug, Default)]
pub(super) struct Queue {
    waiting: Vec<u8>,
}

impl Queue {
    pub(super) fn is_empty(&self) -> bool {
        self.waiting.is_empty()
    }

    pub(super) fn clear(&mut self) {
        self.waiting.clear();
    }

    /// Sends a packet behind those that wait, or drops it whole.
    pub(super) fn send(&mut self, stream: &mut impl Write, packet: &[u8]) -> io::Result<Sent> {
        if self.waiting.len() + packet.len() > WAITING_MAX_BYTES {
            self.flush(stream)?;
        }
        if self.waiting.len() + packet.len() > WAITING_MAX_BYTES {
            return Ok(Sent::Dropped);
        }
        self.waiting.extend_from_slice(packet);
        self.flush(stream)?;
        Ok(Sent::Whole)
    }

    /// Sends what waits, as far as the stream takes it.
    pub(super) fn flush(&mut self, stream: &mut impl Write) -> io::Result<()> {
        while !self.waiting.is_empty() {
            match stream.write(&self.waiting) {
                Ok(0) => return Err(io::ErrorKind::WriteZero.into()),
                Ok(taken) => drop(self.waiting.drain(..taken)),
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => return Ok(()),
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) => return Err(error),
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Takes so many bytes, and then none.
    struct Slow(usize, Vec<u8>);

    impl Write for Slow {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            let taken = bytes.len().min(self.0);
            if taken == 0 {
                return Err(io::ErrorKind::WouldBlock.into());
            }
            self.0 -= taken;
            self.1.extend_from_slice(&bytes[..taken]);
            Ok(taken)
        }
        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn a_slow_stream_loses_whole_packets_only() {
        let mut slow = Slow(150, Vec::new());
        let mut queue = Queue::default();
        let sent: Vec<Sent> =
            (0..100).map(|number| queue.send(&mut slow, &[number; 100]).unwrap()).collect();
        let whole = sent.iter().filter(|sent| **sent == Sent::Whole).count();
        assert_eq!(whole, 1 + (WAITING_MAX_BYTES + 50) / 100 - usize::from(whole > 83));

        slow.0 = usize::MAX;
        queue.flush(&mut slow).unwrap();
        assert!(queue.is_empty());
        assert_eq!(slow.1.len(), whole * 100);
        assert!(slow.1.chunks(100).all(|packet| packet.iter().all(|byte| *byte == packet[0])));
    }
}
