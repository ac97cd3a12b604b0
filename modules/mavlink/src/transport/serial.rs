//! A serial device: a radio, a USB port, or a pty.
//!
//! A device that was unplugged is opened again when it is back.

use std::fs::{File, OpenOptions};
use std::io::{self, Read};
use std::os::fd::{AsFd, BorrowedFd};
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};

use nix::poll::PollFlags;
use nix::sys::termios::{BaudRate, SetArg, cfmakeraw, cfsetspeed, tcgetattr, tcsetattr};
use uorb_core::now_us;

use super::queue::Queue;
use super::{Sent, Transport};
use crate::frame::Delivery;

/// How often a device that has gone is looked for.
const OPEN_EVERY_US: u64 = 1_000_000;

pub(super) struct Serial {
    device: PathBuf,
    baud: u32,
    file: Option<File>,
    queue: Queue,
    has_begun: bool,
    next_try_us: u64,
}

impl Serial {
    pub(super) fn open(device: &Path, baud: u32) -> io::Result<Self> {
        Ok(Self {
            device: device.into(),
            baud,
            file: Some(open(device, baud)?),
            queue: Queue::default(),
            has_begun: false,
            next_try_us: 0,
        })
    }

    fn close(&mut self) {
        self.file = None;
        self.queue.clear();
        self.next_try_us = now_us() + OPEN_EVERY_US;
    }
}

/// Opens a device: raw, at this speed, without waiting.
fn open(device: &Path, baud: u32) -> io::Result<File> {
    let speed = speed(baud).ok_or_else(|| {
        let known = "9600, 19200, 38400, 57600, 115200, 230400, 460800, 921600, ..";
        io::Error::new(io::ErrorKind::InvalidInput, format!("no serial speed: {baud} ({known})"))
    })?;
    let flags = libc::O_NOCTTY | libc::O_NONBLOCK;
    let file = OpenOptions::new().read(true).write(true).custom_flags(flags).open(device)?;
    let mut settings = tcgetattr(&file)?;
    cfmakeraw(&mut settings);
    cfsetspeed(&mut settings, speed)?;
    tcsetattr(&file, SetArg::TCSANOW, &settings)?;
    Ok(file)
}

fn speed(baud: u32) -> Option<BaudRate> {
    Some(match baud {
        9600 => BaudRate::B9600,
        19200 => BaudRate::B19200,
        38400 => BaudRate::B38400,
        57600 => BaudRate::B57600,
        115_200 => BaudRate::B115200,
        230_400 => BaudRate::B230400,
        460_800 => BaudRate::B460800,
        500_000 => BaudRate::B500000,
        921_600 => BaudRate::B921600,
        1_000_000 => BaudRate::B1000000,
        1_500_000 => BaudRate::B1500000,
        2_000_000 => BaudRate::B2000000,
        3_000_000 => BaudRate::B3000000,
        _ => return None,
    })
}

impl Transport for Serial {
    fn descriptors(&self) -> Vec<(BorrowedFd<'_>, PollFlags)> {
        let mut events = PollFlags::POLLIN;
        events.set(PollFlags::POLLOUT, !self.queue.is_empty());
        self.file.iter().map(|file| (file.as_fd(), events)).collect()
    }

    fn delivery(&self) -> Delivery {
        Delivery::Line
    }

    fn receive(&mut self, buffer: &mut [u8]) -> Option<usize> {
        if self.file.is_none() && now_us() >= self.next_try_us {
            self.next_try_us = now_us() + OPEN_EVERY_US;
            self.file = open(&self.device, self.baud).ok();
            self.has_begun = self.file.is_some();
        }
        let file = self.file.as_mut()?;
        match self.queue.flush(file).and_then(|()| file.read(buffer)) {
            Ok(len) if len > 0 => return Some(len),
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => {}
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            // Unplugged, or a pty whose other end has closed.
            _ => self.close(),
        }
        None
    }

    fn has_begun(&mut self) -> bool {
        std::mem::take(&mut self.has_begun)
    }

    fn send(&mut self, packet: &[u8]) -> Sent {
        let Some(file) = &mut self.file else { return Sent::Nobody };
        self.queue.send(file, packet).unwrap_or_else(|_| {
            self.close();
            Sent::Nobody
        })
    }

    fn describe(&self) -> String {
        let gone = if self.file.is_none() { " (gone)" } else { "" };
        format!("serial {} {} baud{gone}", self.device.display(), self.baud)
    }
}
