//! Commands: COMMAND_LONG, COMMAND_INT and SET_MODE, and their answers.
//!
//! Whoever sends a command has exactly one COMMAND_ACK for it. What is about the
//! link itself (which messages go out, and how often) is done here and answered at
//! once. All others go to the topic `vehicle_command`, and wait for the
//! `vehicle_command_ack` with their number. As long as nobody advertises that,
//! nobody would answer: the command is unsupported.
//!
//! A command that comes again while it waits, and says so (`confirmation`) or has the
//! same parameters, is the same command; with others it is another, that has an answer
//! of its own. One that comes again after its answer, and says so, had its answer lost:
//! the answer goes out again, and nobody obeys twice.

use std::collections::VecDeque;

use mavlink_core::MavHeader;
use uorb_core::{RawSubscription, Session, now_us};
use uorb_msg::{VehicleCommand, VehicleCommandAck};

use crate::dialect::{
    COMMAND_ACK_DATA, COMMAND_INT_DATA, COMMAND_LONG_DATA, MESSAGE_INTERVAL_DATA, MavMessage,
    PROTOCOL_VERSION_DATA, SET_MODE_DATA,
};
use crate::followed::Followed;
use crate::link::Link;
use crate::outgoing::Rate;

/// How long a command waits for its answer. Then it has failed.
const TIMEOUT_US: u64 = 3_000_000;

/// For so long an answer can be had again.
const REMEMBERED_US: u64 = 5_000_000;

/// So many commands of a link wait at once.
const PENDING_MAX: usize = 32;

/// And so many answers are remembered.
const ANSWERED_MAX: usize = 32;

/// Values of MAV_CMD that are about the link.
const GET_MESSAGE_INTERVAL: u32 = 510;
const SET_MESSAGE_INTERVAL: u32 = 511;
const REQUEST_MESSAGE: u32 = 512;
const REQUEST_PROTOCOL_VERSION: u32 = 519;
const REQUEST_AUTOPILOT_CAPABILITIES: u32 = 520;

/// Numbers of messages.
const AUTOPILOT_VERSION: u32 = 148;
const PROTOCOL_VERSION: u32 = 300;

/// Values of MAV_RESULT.
const ACCEPTED: u8 = 0;
const TEMPORARILY_REJECTED: u8 = 1;
const DENIED: u8 = 2;
const UNSUPPORTED: u8 = 3;
const FAILED: u8 = 4;
const IN_PROGRESS: u8 = 5;

/// A command, and who has sent it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Question {
    command: u16,
    system_id: u8,
    component_id: u8,
}

/// All seven, as bits: what is not a number is equal to itself, too.
type Parameters = [u64; 7];

#[derive(Clone, Copy, Debug)]
struct Pending {
    question: Question,
    parameters: Parameters,
    due_us: u64,
}

#[derive(Clone, Copy, Debug)]
struct Answered {
    question: Question,
    result: u8,
    until_us: u64,
}

/// Questions and answers, without a bus: which answer belongs to whom.
#[derive(Debug, Default)]
struct Ledger {
    /// In the order in which they came.
    pending: Vec<Pending>,
    answered: VecDeque<Answered>,
}

/// What is to be done about a question.
#[derive(Debug, PartialEq, Eq)]
enum Step {
    /// It is new.
    Ask,
    /// Its answer is awaited.
    Wait,
    /// It has been answered so.
    Answer(u8),
}

impl Ledger {
    fn look(
        &mut self,
        question: Question,
        parameters: Parameters,
        confirmation: u8,
        now_us: u64,
    ) -> Step {
        let is_same = |pending: &Pending| {
            pending.question == question && (confirmation > 0 || pending.parameters == parameters)
        };
        if self.pending.iter().any(is_same) {
            return Step::Wait;
        }
        self.answered.retain(|answered| now_us < answered.until_us);
        let before = self.answered.iter().rev().find(|answered| answered.question == question);
        match before {
            Some(answered) if confirmation > 0 => Step::Answer(answered.result),
            _ if self.pending.len() >= PENDING_MAX => Step::Answer(TEMPORARILY_REJECTED),
            _ => Step::Ask,
        }
    }

    fn wait(&mut self, question: Question, parameters: Parameters, now_us: u64) {
        self.pending.push(Pending { question, parameters, due_us: now_us + TIMEOUT_US });
    }

    /// Whose question that answers: answers come in the order of the questions.
    fn settle(&mut self, command: u16, result: u8, now_us: u64) -> Option<Question> {
        let is_it = |pending: &Pending| pending.question.command == command;
        let index = self.pending.iter().position(is_it)?;
        if result == IN_PROGRESS {
            self.pending[index].due_us = now_us + TIMEOUT_US;
            return Some(self.pending[index].question);
        }
        let question = self.pending.remove(index).question;
        self.remember(question, result, now_us);
        Some(question)
    }

    fn remember(&mut self, question: Question, result: u8, now_us: u64) {
        if self.answered.len() >= ANSWERED_MAX {
            self.answered.pop_front();
        }
        self.answered.push_back(Answered { question, result, until_us: now_us + REMEMBERED_US });
    }

    /// One that has waited long enough.
    fn expire(&mut self, now_us: u64) -> Option<Question> {
        let index = self.pending.iter().position(|pending| now_us >= pending.due_us)?;
        let question = self.pending.remove(index).question;
        self.remember(question, FAILED, now_us);
        Some(question)
    }
}

/// The commands of a link.
#[derive(Debug)]
pub struct Commands {
    acks: Followed<VehicleCommandAck>,
    ledger: Ledger,
}

impl Commands {
    pub(super) fn new(session: &Session) -> Self {
        let mut acks = Followed::new(session);
        // They are about questions of others.
        acks.skip();
        Self { acks, ledger: Ledger::default() }
    }

    /// Obeys, or asks those who can.
    pub(super) fn receive(&mut self, link: &mut Link, command: &VehicleCommand) {
        let Some(question) = question(command) else { return };
        match own(link, command) {
            Some(result) => answer(link, question, result),
            None => self.relay(link, question, command),
        }
    }

    fn relay(&mut self, link: &mut Link, question: Question, command: &VehicleCommand) {
        // What was answered before this was asked is no answer to it.
        self.step(link, now_us());
        let parameters = parameters(command);
        match self.ledger.look(question, parameters, command.confirmation, now_us()) {
            Step::Wait => {}
            Step::Answer(result) => answer(link, question, result),
            Step::Ask => {
                let somebody_answers = self.acks.raw().is_some_and(|raw| raw.advertised());
                link.publications.publish::<VehicleCommand>(command);
                match somebody_answers {
                    true => self.ledger.wait(question, parameters, now_us()),
                    false => answer(link, question, UNSUPPORTED),
                }
            }
        }
    }

    /// Passes on the answers that are there, and tells those who wait in vain.
    pub(super) fn step(&mut self, link: &mut Link, now_us: u64) {
        while let Some(ack) = self.acks.update() {
            if let Some(question) = self.ledger.settle(ack.command, ack.result, now_us) {
                answer(link, question, ack.result);
            }
        }
        while let Some(question) = self.ledger.expire(now_us) {
            answer(link, question, FAILED);
        }
    }

    pub(super) fn subscription(&mut self) -> Option<&mut RawSubscription> {
        self.acks.raw()
    }

    pub(super) fn due_us(&self) -> u64 {
        self.ledger.pending.iter().map(|pending| pending.due_us).min().unwrap_or(u64::MAX)
    }
}

fn question(command: &VehicleCommand) -> Option<Question> {
    Some(Question {
        command: u16::try_from(command.command).ok()?,
        system_id: u8::try_from(command.source_system).ok()?,
        component_id: u8::try_from(command.source_component).ok()?,
    })
}

fn parameters(command: &VehicleCommand) -> Parameters {
    let VehicleCommand { param1, param2, param3, param4, param5, param6, param7, .. } = *command;
    let [param1, param2, param3, param4, param7] =
        [param1, param2, param3, param4, param7].map(f64::from);
    [param1, param2, param3, param4, param5, param6, param7].map(f64::to_bits)
}

fn answer(link: &mut Link, question: Question, result: u8) {
    link.send(&MavMessage::COMMAND_ACK(COMMAND_ACK_DATA {
        command: question.command,
        result,
        target_system: question.system_id,
        target_component: question.component_id,
        ..COMMAND_ACK_DATA::DEFAULT
    }));
}

/// Obeys what is about the link; the result. None: it is about the vehicle.
fn own(link: &mut Link, command: &VehicleCommand) -> Option<u8> {
    Some(match command.command {
        SET_MESSAGE_INTERVAL => set_message_interval(link, command.param1, command.param2),
        GET_MESSAGE_INTERVAL => get_message_interval(link, command.param1),
        REQUEST_MESSAGE => match message_id(command.param1) {
            Some(id) => request_message(link, id),
            None => DENIED,
        },
        REQUEST_PROTOCOL_VERSION => request_message(link, PROTOCOL_VERSION),
        REQUEST_AUTOPILOT_CAPABILITIES => request_message(link, AUTOPILOT_VERSION),
        _ => return None,
    })
}

/// A number of a message, which has three bytes.
fn message_id(param: f32) -> Option<u32> {
    let is_id = (0.0..16_777_216.0).contains(&param) && param.fract() == 0.0;
    is_id.then_some(param as u32)
}

/// -1 stops a stream, 0 is as the mode has it.
fn wanted_rate(interval_us: f32) -> Option<Option<Rate>> {
    match interval_us {
        -1.0 => Some(Some(Rate::Off)),
        0.0 => Some(None),
        _ if interval_us >= 1.0 && interval_us.is_finite() => {
            Some(Some(Rate::Hz(1e6 / interval_us)))
        }
        _ => None,
    }
}

fn set_message_interval(link: &mut Link, id: f32, interval_us: f32) -> u8 {
    match (message_id(id), wanted_rate(interval_us)) {
        (Some(id), Some(rate)) if link.streams.set_rate(id, rate) => ACCEPTED,
        (Some(_), Some(_)) => FAILED,
        _ => DENIED,
    }
}

/// What MESSAGE_INTERVAL says: -1 is off, 0 is "no such stream".
fn interval_us(rate: Option<Rate>) -> i32 {
    match rate {
        None => 0,
        Some(Rate::Off) => -1,
        // As often as there is something: no time at all is taken by "none".
        Some(Rate::Every) => 1,
        Some(Rate::Hz(hz)) => (1e6 / hz).round().max(1.0) as i32,
    }
}

fn get_message_interval(link: &mut Link, id: f32) -> u8 {
    // The message has two bytes for the number.
    let Some(id) = message_id(id).and_then(|id| u16::try_from(id).ok()) else { return DENIED };
    let interval_us = interval_us(link.streams.rate(id.into()));
    let message = MESSAGE_INTERVAL_DATA { message_id: id, interval_us };
    link.send(&MavMessage::MESSAGE_INTERVAL(message));
    ACCEPTED
}

fn request_message(link: &mut Link, id: u32) -> u8 {
    if id == PROTOCOL_VERSION {
        link.send(&MavMessage::PROTOCOL_VERSION(PROTOCOL_VERSION_DATA {
            version: 200,
            min_version: 100,
            max_version: 200,
            ..PROTOCOL_VERSION_DATA::DEFAULT
        }));
        return ACCEPTED;
    }
    if link.streams.rate(id).is_none() {
        return UNSUPPORTED;
    }
    match link.streams.send_once(id, &mut link.port) {
        true => ACCEPTED,
        // Nothing was published yet that it could be made of.
        false => TEMPORARILY_REJECTED,
    }
}

/// COMMAND_LONG, as the bus has it.
pub fn command_long(message: &COMMAND_LONG_DATA, from: &MavHeader, now_us: u64) -> VehicleCommand {
    VehicleCommand {
        timestamp: now_us,
        param1: message.param1,
        param2: message.param2,
        param3: message.param3,
        param4: message.param4,
        param5: message.param5.into(),
        param6: message.param6.into(),
        param7: message.param7,
        command: message.command.into(),
        target_system: message.target_system.into(),
        target_component: message.target_component.into(),
        source_system: from.system_id,
        source_component: from.component_id.into(),
        confirmation: message.confirmation,
        ..Default::default()
    }
}

/// COMMAND_INT, as the bus has it: degrees, or metres in a local frame.
pub fn command_int(message: &COMMAND_INT_DATA, from: &MavHeader, now_us: u64) -> VehicleCommand {
    let is_global = matches!(message.frame, 0 | 3 | 5 | 6 | 10 | 11);
    let unit = if is_global { 1e-7 } else { 1e-4 };
    let place = |value: i32| match value {
        i32::MAX => f64::NAN,
        value => f64::from(value) * unit,
    };
    VehicleCommand {
        timestamp: now_us,
        param1: message.param1,
        param2: message.param2,
        param3: message.param3,
        param4: message.param4,
        param5: place(message.x),
        param6: place(message.y),
        param7: message.z,
        command: message.command.into(),
        target_system: message.target_system.into(),
        target_component: message.target_component.into(),
        source_system: from.system_id,
        source_component: from.component_id.into(),
        ..Default::default()
    }
}

/// SET_MODE, the older way to say so.
pub fn set_mode(message: &SET_MODE_DATA, from: &MavHeader, now_us: u64) -> VehicleCommand {
    let [_, _, main, sub] = message.custom_mode.to_le_bytes();
    VehicleCommand {
        timestamp: now_us,
        param1: f32::from(message.base_mode),
        param2: main.into(),
        param3: sub.into(),
        command: VehicleCommand::VEHICLE_CMD_DO_SET_MODE,
        target_system: message.target_system.into(),
        source_system: from.system_id,
        source_component: from.component_id.into(),
        ..Default::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FROM: MavHeader = MavHeader { system_id: 255, component_id: 190, sequence: 0 };
    const ARM: Question = Question { command: 400, system_id: 255, component_id: 190 };
    const OFF: Parameters = [0; 7];
    const ON: Parameters = [1, 0, 0, 0, 0, 0, 0];

    #[test]
    fn a_question_has_one_answer_however_often_it_is_asked() {
        let mut ledger = Ledger::default();
        assert_eq!(ledger.look(ARM, ON, 0, 0), Step::Ask);
        ledger.wait(ARM, ON, 0);
        assert_eq!(ledger.look(ARM, ON, 0, 400_000), Step::Wait);
        assert_eq!(ledger.look(ARM, OFF, 1, 500_000), Step::Wait, "it says that it was asked");
        assert_eq!(ledger.settle(400, ACCEPTED, 600_000), Some(ARM));
        assert_eq!(ledger.settle(400, ACCEPTED, 600_001), None, "of somebody else's question");

        // The answer was lost: the same again, and nobody obeys twice.
        assert_eq!(ledger.look(ARM, ON, 2, 700_000), Step::Answer(ACCEPTED));
        // It is asked anew.
        assert_eq!(ledger.look(ARM, ON, 0, 800_000), Step::Ask);
        assert_eq!(ledger.look(ARM, ON, 1, 600_000 + REMEMBERED_US), Step::Ask, "long ago");
    }

    #[test]
    fn another_question_of_the_same_number_waits_behind_the_first() {
        let mut ledger = Ledger::default();
        ledger.wait(ARM, ON, 0);
        assert_eq!(ledger.look(ARM, OFF, 0, 1), Step::Ask);
        ledger.wait(ARM, OFF, 1);
        assert_eq!(ledger.settle(400, DENIED, 2), Some(ARM));
        assert_eq!(ledger.look(ARM, OFF, 0, 3), Step::Wait);
        assert_eq!(ledger.settle(400, ACCEPTED, 4), Some(ARM));
        assert_eq!(ledger.look(ARM, OFF, 1, 5), Step::Answer(ACCEPTED));
    }

    #[test]
    fn answers_go_to_whoever_asked_first() {
        let other = Question { system_id: 254, ..ARM };
        let mut ledger = Ledger::default();
        ledger.wait(ARM, ON, 0);
        ledger.wait(other, ON, 1);
        assert_eq!(ledger.settle(176, DENIED, 2), None, "another command");
        assert_eq!(ledger.settle(400, DENIED, 2), Some(ARM));
        assert_eq!(ledger.settle(400, DENIED, 3), Some(other));
    }

    #[test]
    fn what_is_in_progress_goes_on_waiting_and_silence_fails() {
        let mut ledger = Ledger::default();
        ledger.wait(ARM, ON, 0);
        assert_eq!(ledger.expire(TIMEOUT_US - 1), None);
        assert_eq!(ledger.settle(400, IN_PROGRESS, TIMEOUT_US - 1), Some(ARM));
        assert_eq!(ledger.expire(TIMEOUT_US), None);
        assert_eq!(ledger.expire(2 * TIMEOUT_US), Some(ARM));
        assert_eq!(ledger.settle(400, ACCEPTED, 2 * TIMEOUT_US), None, "too late");
    }

    #[test]
    fn a_flood_of_questions_waits_for_the_first_ones() {
        let mut ledger = Ledger::default();
        let questions = (0..PENDING_MAX as u16).map(|command| Question { command, ..ARM });
        questions.for_each(|question| ledger.wait(question, ON, 0));
        assert_eq!(ledger.look(ARM, ON, 0, 0), Step::Answer(TEMPORARILY_REJECTED));
        (0..1_000).for_each(|command| ledger.remember(Question { command, ..ARM }, DENIED, 0));
        assert_eq!(ledger.answered.len(), ANSWERED_MAX);
    }

    #[test]
    fn places_are_degrees_or_metres_or_none() {
        let message = |frame, x| COMMAND_INT_DATA { frame, x, ..COMMAND_INT_DATA::DEFAULT };
        let degrees = command_int(&message(6, 473_977_420), &FROM, 5).param5;
        assert!((degrees - 47.397_742).abs() < 1e-9, "{degrees}");
        let metres = command_int(&message(1, 15_000), &FROM, 5).param5;
        assert!((metres - 1.5).abs() < 1e-9, "{metres}");
        assert!(command_int(&message(6, i32::MAX), &FROM, 5).param5.is_nan());
    }

    #[test]
    fn a_command_says_who_sent_it_and_to_whom() {
        let message = COMMAND_LONG_DATA {
            target_system: 1,
            target_component: 1,
            command: 400,
            confirmation: 2,
            param1: 1.0,
            param7: 7.0,
            ..COMMAND_LONG_DATA::DEFAULT
        };
        let command = command_long(&message, &FROM, 5);
        assert_eq!((command.timestamp, command.command, command.confirmation), (5, 400, 2));
        assert_eq!((command.source_system, command.source_component), (255, 190));
        assert_eq!((command.target_system, command.target_component), (1, 1));
        assert_eq!((command.param1, command.param7), (1.0, 7.0));
        assert_eq!(question(&command), Some(ARM));
        let same = |one, other| parameters(one) == parameters(other);
        let unknown = VehicleCommand { param5: f64::NAN, ..command };
        assert!(same(&unknown, &unknown) && !same(&unknown, &command));
    }

    #[test]
    fn a_mode_is_main_and_sub() {
        let message = SET_MODE_DATA { target_system: 1, base_mode: 1, custom_mode: 0x0304_0000 };
        let command = set_mode(&message, &FROM, 0);
        assert_eq!((command.param1, command.param2, command.param3), (1.0, 4.0, 3.0));
        assert_eq!(command.command, VehicleCommand::VEHICLE_CMD_DO_SET_MODE);
    }

    #[test]
    fn intervals_are_microseconds_with_two_words() {
        assert_eq!(wanted_rate(-1.0), Some(Some(Rate::Off)));
        assert_eq!(wanted_rate(0.0), Some(None));
        assert_eq!(wanted_rate(20_000.0), Some(Some(Rate::Hz(50.0))));
        for wrong in [-2.0, 0.5, f32::NAN, f32::INFINITY] {
            assert_eq!(wanted_rate(wrong), None, "{wrong}");
        }
        assert_eq!(interval_us(Some(Rate::Hz(50.0))), 20_000);
        assert_eq!(interval_us(Some(Rate::Off)), -1);
        assert_eq!(interval_us(None), 0);
    }

    #[test]
    fn a_number_of_a_message_is_whole() {
        assert_eq!(message_id(24_166.0), Some(24_166));
        for wrong in [-1.0, 0.5, f32::NAN, 16_777_216.0, f32::INFINITY] {
            assert_eq!(message_id(wrong), None, "{wrong}");
        }
    }
}
