// SPDX-License-Identifier: GPL-3.0-or-later
// A hand-written rasteriser with AVX2 and FMA, as a yardstick for our kernel: the same splats, the same tile lists, the same picture.
// benchmarks/raster_cpu.py compiles it, gives it its input, and prints both times.
//
//   raster_limit SPLATS STARTS IDS WIDTH HEIGHT RUNS PICTURE
//
//   SPLATS   float32 [N, 9]: x, y in pixels; the inverse covariance A, B, C; opacity; red, green, blue
//   STARTS   int64 [tiles + 1]: where the list of each tile of 16 x 16 pixels begins; tiles row by row
//   IDS      int32 [entries]: the splats of each tile, front to back
//   PICTURE  is written: float32 [H, W, 4], premultiplied colour and alpha
//
// It prints the median of RUNS in milliseconds; a first run is not counted.
#include <immintrin.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <fstream>
#include <iostream>
#include <iterator>
#include <vector>

namespace {

constexpr int kTile = 16, kHalves = 2;
constexpr float kLog2E = 1.44269504f, kLeast = 1 / 255.f, kMost = 0.999f, kDark = 1e-4f;

struct Splat { float x, y, a, b, c, opacity, colour[3]; };

template <class T> std::vector<T> load(const char *name) {
  std::ifstream file(name, std::ios::binary);
  std::vector<char> bytes((std::istreambuf_iterator<char>(file)), {});
  const T *first = reinterpret_cast<const T *>(bytes.data());
  return {first, first + bytes.size() / sizeof(T)};
}

// 2^x of eight numbers from -120 to 0: the whole part goes into the exponent, the rest (at most a half) through Taylor's series.
inline __m256 power_of_two(__m256 x) {
  const __m256 whole = _mm256_round_ps(x, _MM_FROUND_TO_NEAREST_INT | _MM_FROUND_NO_EXC);
  const __m256 rest = _mm256_mul_ps(_mm256_sub_ps(x, whole), _mm256_set1_ps(0.69314718f));
  __m256 sum = _mm256_set1_ps(1 / 120.f);
  for (float factor : {1 / 24.f, 1 / 6.f, 1 / 2.f, 1.f, 1.f}) sum = _mm256_fmadd_ps(sum, rest, _mm256_set1_ps(factor));
  const __m256i shift = _mm256_slli_epi32(_mm256_cvtps_epi32(whole), 23);
  return _mm256_castsi256_ps(_mm256_add_epi32(_mm256_castps_si256(sum), shift));
}

struct Tile {
  __m256 light[kTile][kHalves], colour[3][kTile][kHalves];

  Tile() {
    for (auto &row : light) for (auto &half : row) half = _mm256_set1_ps(1);
    for (auto &channel : colour) for (auto &row : channel) for (auto &half : row) half = _mm256_setzero_ps();
  }

  bool dark() const {
    __m256 most = _mm256_setzero_ps();
    for (auto &row : light) for (auto half : row) most = _mm256_max_ps(most, half);
    return !_mm256_movemask_ps(_mm256_cmp_ps(most, _mm256_set1_ps(kDark), _CMP_GE_OQ));
  }

  // left, top: the centre of the tile's first pixel
  void blend(const Splat &s, float left, float top) {
    const float x = s.x - left, y = s.y - top;
    const float cut = 2 * std::log(s.opacity / kLeast), area = s.a * s.c - s.b * s.b;  // alpha is kLeast on this ellipse
    const float wide = std::sqrt(cut * s.c / area), high = std::sqrt(cut * s.a / area);
    const int first = std::max(0, int(std::ceil(y - high))), last = std::min(kTile - 1, int(std::floor(y + high)));
    const int from = std::max(0, int(std::ceil(x - wide))) / 8, to = std::min(kTile - 1, int(std::floor(x + wide)));
    if (to < 8 * from) return;
    const __m256 columns = _mm256_setr_ps(0, 1, 2, 3, 4, 5, 6, 7), opacity = _mm256_set1_ps(s.opacity);
    const __m256 square = _mm256_set1_ps(-0.5f * kLog2E * s.a);
    for (int row = first; row <= last; ++row) {
      const float dy = row - y;
      const __m256 linear = _mm256_set1_ps(-kLog2E * s.b * dy), constant = _mm256_set1_ps(-0.5f * kLog2E * s.c * dy * dy);
      for (int half = from; half <= to / 8; ++half) {
        const __m256 dx = _mm256_add_ps(columns, _mm256_set1_ps(8 * half - x));
        __m256 exponent = _mm256_fmadd_ps(_mm256_fmadd_ps(square, dx, linear), dx, constant);
        exponent = _mm256_max_ps(exponent, _mm256_set1_ps(-120));
        __m256 alpha = _mm256_min_ps(_mm256_mul_ps(opacity, power_of_two(exponent)), _mm256_set1_ps(kMost));
        alpha = _mm256_and_ps(alpha, _mm256_cmp_ps(alpha, _mm256_set1_ps(kLeast), _CMP_GE_OQ));
        const __m256 weight = _mm256_mul_ps(alpha, light[row][half]);
        light[row][half] = _mm256_sub_ps(light[row][half], weight);
        for (int c = 0; c < 3; ++c) colour[c][row][half] = _mm256_fmadd_ps(weight, _mm256_set1_ps(s.colour[c]), colour[c][row][half]);
      }
    }
  }

  void store(float *picture, int width, int height, int column, int row) const {
    for (int y = 0; y < std::min(kTile, height - row); ++y)
      for (int x = 0; x < std::min(kTile, width - column); ++x) {
        float *pixel = picture + 4 * (std::size_t(row + y) * width + column + x);
        for (int c = 0; c < 3; ++c) pixel[c] = colour[c][y][x / 8][x % 8];
        pixel[3] = 1 - light[y][x / 8][x % 8];
      }
  }
};

}  // namespace

int main(int count, char **given) {
  if (count != 8) return std::cerr << "the head of raster_limit.cpp says what it takes\n", 2;
  const auto splats = load<Splat>(given[1]);
  const auto starts = load<std::int64_t>(given[2]);
  const auto ids = load<std::int32_t>(given[3]);
  const int width = std::atoi(given[4]), height = std::atoi(given[5]), runs = std::atoi(given[6]);
  const int columns = (width + kTile - 1) / kTile, rows = (height + kTile - 1) / kTile;
  if (starts.size() != std::size_t(columns) * rows + 1) return std::cerr << "the lists are of another size\n", 2;
  std::vector<float> picture(std::size_t(width) * height * 4);
  std::vector<double> times;
  for (int run = 0; run <= runs; ++run) {
    const auto begin = std::chrono::steady_clock::now();
#pragma omp parallel for schedule(dynamic, 4)
    for (int number = 0; number < columns * rows; ++number) {
      const int column = number % columns * kTile, row = number / columns * kTile;
      Tile tile;
      for (auto entry = starts[number]; entry < starts[number + 1]; ++entry) {
        tile.blend(splats[ids[entry]], column + 0.5f, row + 0.5f);
        if ((entry - starts[number]) % 16 == 15 && tile.dark()) break;
      }
      tile.store(picture.data(), width, height, column, row);
    }
    if (run) times.push_back(std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - begin).count());
  }
  std::nth_element(times.begin(), times.begin() + times.size() / 2, times.end());
  std::cout << times[times.size() / 2] << " ms\n";
  std::ofstream(given[7], std::ios::binary).write(reinterpret_cast<char *>(picture.data()), 4 * picture.size());
}
