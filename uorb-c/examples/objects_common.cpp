/*
 * Seed 001, "step 1: add a uORB topic": the lines that it adds to PX4's file of
 * this name. Nothing had to be mended.
 */

#include "topics/ca_trajectory_msg.h"
ORB_DEFINE(ca_trajectory_msg, struct ca_traj_struct_s);
