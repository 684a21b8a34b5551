// Publishes serialized messages at a given rate, without Python in the way.
//
// A library and not a program, because the ROS wheels' own libraries need the symbols of Python:
// publisher.py builds it, loads it and calls `publish`.

#include <poll.h>
#include <time.h>
#include <unistd.h>

#include <algorithm>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <iterator>
#include <string>
#include <vector>

#include <geometry_msgs/msg/twist.h>
#include <nav_msgs/msg/odometry.h>
#include <rcl/error_handling.h>
#include <rcl/rcl.h>
#include <sensor_msgs/msg/image.h>

namespace {

// Deeper, and once its history is full Fast DDS needs 25 us for a message instead of 9: it moves
// every entry up by one.
constexpr size_t kDepth = 1000;
constexpr long kNapNs = 200000;
constexpr size_t kNoiseBytes = 1 << 20;

void check(rcl_ret_t code, const char *what) {
  if (code != RCL_RET_OK) {
    std::fprintf(stderr, "%s failed: %s\n", what, rcl_get_error_string().str);
    std::exit(1);
  }
}

double now_s() {
  timespec now;
  clock_gettime(CLOCK_MONOTONIC, &now);
  return now.tv_sec + 1e-9 * now.tv_nsec;
}

// Whether stdin was closed; waits for it so long.
bool told_to_stop(int wait_ms) {
  pollfd input{STDIN_FILENO, POLLIN, 0};
  char byte;
  return poll(&input, 1, wait_ms) > 0 && read(STDIN_FILENO, &byte, 1) == 0;
}

const rosidl_message_type_support_t *type_support(const std::string &type) {
  if (type == "twist") return ROSIDL_GET_MSG_TYPE_SUPPORT(geometry_msgs, msg, Twist);
  if (type == "odometry") return ROSIDL_GET_MSG_TYPE_SUPPORT(nav_msgs, msg, Odometry);
  if (type == "image") return ROSIDL_GET_MSG_TYPE_SUPPORT(sensor_msgs, msg, Image);
  std::fprintf(stderr, "unknown type %s\n", type.c_str());
  std::exit(2);
}

// Messages of four bits of noise in a byte, as a camera gives; too many for zstd to see them repeat.
std::vector<rcl_serialized_message_t> messages_of(size_t size) {
  rcl_allocator_t allocator = rcl_get_default_allocator();
  std::vector<rcl_serialized_message_t> messages(std::max<size_t>(4, kNoiseBytes / size));
  uint32_t dice = 1;
  for (rcl_serialized_message_t &message : messages) {
    message = rmw_get_zero_initialized_serialized_message();
    check(rmw_serialized_message_init(&message, size, &allocator), "allocating");
    for (size_t at = 0; at < size; ++at) {
      dice = dice * 1664525u + 1013904223u;
      message.buffer[at] = dice >> 28;
    }
    const uint8_t little_endian[] = {0, 1, 0, 0};
    std::copy(std::begin(little_endian), std::end(little_endian), message.buffer);
    message.buffer_length = size;
  }
  return messages;
}

}  // namespace

// Announce `topic` as `type_name` (twist, odometry or image), wait for a subscription, publish until
// stdin is closed, and say in a line of JSON how many were sent and how many in a second. The content
// is a header of CDR and noise: a recorder never looks inside.
extern "C" void publish(const char *topic, const char *type_name, size_t bytes, double rate) {
  const rosidl_message_type_support_t *type = type_support(type_name);
  const std::vector<rcl_serialized_message_t> messages = messages_of(bytes);

  rcl_init_options_t init = rcl_get_zero_initialized_init_options();
  check(rcl_init_options_init(&init, rcl_get_default_allocator()), "rcl_init_options_init");
  rcl_context_t context = rcl_get_zero_initialized_context();
  check(rcl_init(0, nullptr, &init, &context), "rcl_init");
  rcl_node_t node = rcl_get_zero_initialized_node();
  rcl_node_options_t node_options = rcl_node_get_default_options();
  node_options.enable_rosout = false;
  check(rcl_node_init(&node, "load", "", &context, &node_options), "rcl_node_init");
  rcl_publisher_t publisher = rcl_get_zero_initialized_publisher();
  rcl_publisher_options_t options = rcl_publisher_get_default_options();
  options.qos.depth = kDepth;
  check(rcl_publisher_init(&publisher, &node, type, topic, &options), "rcl_publisher_init");

  for (size_t subscriptions = 0; subscriptions == 0;) {
    if (told_to_stop(10)) return;
    check(rcl_publisher_get_subscription_count(&publisher, &subscriptions), "counting");
  }
  uint64_t sent = 0;
  const double begun = now_s();
  while (!told_to_stop(0)) {
    const uint64_t due = static_cast<uint64_t>((now_s() - begun) * rate);
    for (int burst = 0; sent < due && burst < 1000; ++burst, ++sent) {
      const rcl_serialized_message_t &message = messages[sent % messages.size()];
      check(rcl_publish_serialized_message(&publisher, &message, nullptr), "publishing");
    }
    if (sent >= due) {
      const timespec nap{0, kNapNs};
      nanosleep(&nap, nullptr);
    }
  }
  std::printf("{\"sent\": %llu, \"per_second\": %.1f}\n", static_cast<unsigned long long>(sent),
              sent / (now_s() - begun));
  std::fflush(stdout);
  check(rcl_publisher_fini(&publisher, &node), "rcl_publisher_fini");
  check(rcl_node_fini(&node), "rcl_node_fini");
  check(rcl_shutdown(&context), "rcl_shutdown");
  check(rcl_context_fini(&context), "rcl_context_fini");
}
